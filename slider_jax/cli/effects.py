"""`slider effects`: what the library can add to a model, and what each leaves on the sensors."""

import inspect
from pathlib import Path
from textwrap import indent
from typing import Annotated

import tyro

from slider_jax.cli.options import MaybeFolder
from slider_jax.effects import (
    ActingPressure,
    BendingMoment,
    BodyChange,
    Command,
    Effect,
    Flow,
    ForceDensity,
    Instrument,
    Mounting,
    Prior,
    WaterMotion,
)
from slider_jax.effects.library import LIBRARY
from slider_jax.errors import InputError, did_you_mean

PLACES = (
    Command,
    Flow,
    ActingPressure,
    BodyChange,
    BendingMoment,
    Mounting,
    ForceDensity,
    WaterMotion,
    Instrument,
)
"""Where an effect enters, from the valves to the sensors."""

ExperimentFile = Annotated[Path | None, tyro.conf.arg(metavar="EXPERIMENT.toml")]


def list_effects(
    name: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="NAME")] = None,
    out: MaybeFolder = None,
    experiment: ExperimentFile = None,
) -> None:
    """List the effects that a model may be given, or explain one of them.

    Without a NAME: all effects by the place where they enter, with their parameters' prior ranges
    and the sensors that can see them. With it: equation, source and priors. With --out too, the
    picture DIR/NAME.png of what the effect changes in one steady stride, at the end of the prior
    range. slider effects matrix says which of them an experiment could find.

    Args:
        name: the effect to explain.
        out: folder for the picture; created if missing. An existing file is replaced (default: no
            picture).
        experiment: draw its first trial instead of the built-in robot at 4.8 Hz.
    """
    if name is None:
        for option, given in {"--out": out, "--experiment": experiment}.items():
            if given is not None:
                raise InputError(f"{option}: is for the picture of one effect; give its NAME too")
        print(listing())
        return
    if name not in LIBRARY:
        near = did_you_mean(name, (*LIBRARY, "matrix"))  # which is a command of its own
        raise InputError(f"NAME: given {name!r}; allowed the names that slider effects lists{near}")
    if experiment is not None and out is None:
        raise InputError("--experiment: is for the picture; give --out DIR too")
    if out is None:
        print(explanation(name))
        return
    _draw(name, out, experiment)


def place_of(kind: type[Effect]) -> type[Effect]:
    """Where an effect enters."""
    return next(place for place in PLACES if issubclass(kind, place))


def listing() -> str:
    """All effects, a place at a time."""
    width = max(map(len, LIBRARY))
    lines = [f"{len(LIBRARY)} effects; slider effects NAME explains one"]
    for place in PLACES:
        kinds = {name: kind for name, kind in LIBRARY.items() if place_of(kind) is place}
        if kinds:
            lines += ["", _first_line(place)]
        for name, kind in kinds.items():
            lines.append(f"  {name:<{width}}  {kind.title} ({', '.join(kind.sensors)})")
            for parameter, prior in kind.priors().items():
                lines.append(f"  {'':<{width}}    {parameter}: {_range(prior)}")
    return "\n".join(lines)


def explanation(name: str) -> str:
    """Docstring and priors of one effect."""
    kind = LIBRARY[name]
    lines = [
        f"{name}: {kind.title}",
        "",
        indent(inspect.getdoc(kind) or "", "  "),
        "",
        f"enters at: {_first_line(place_of(kind))}",
        f"seen by:   {', '.join(kind.sensors)}",
        "",
        "parameters",
    ]
    priors = kind.priors()
    rows = [(parameter, _range(prior), prior.why) for parameter, prior in priors.items()]
    widths = [max(len(row[i]) for row in rows) for i in (0, 1)]
    for parameter, span, why in rows:
        lines.append(f"  {parameter:<{widths[0]}}  {span:<{widths[1]}}  {why}")
    given = "".join(f"\n  {key} = {_example(prior):.3g}" for key, prior in priors.items())
    lines += ["", "in an experiment or model file", f'  [[effects]]\n  name = "{name}"{given}']
    return "\n".join(lines)


def _first_line(place: type[Effect]) -> str:
    return (inspect.getdoc(place) or "").splitlines()[0].rstrip(".")


def _range(prior: Prior) -> str:
    unit = "" if prior.unit == "-" else f" {prior.unit}"
    null = "" if prior.null == 0.0 else f", none at {prior.null:g}"
    return f"{prior.low:g} to {prior.high:g}{unit}{null}"


def _example(prior: Prior) -> float:
    """A size to try: half of what is believed possible."""
    from slider_jax.simulation.effect_signature import typical

    return 0.5 * (prior.null + typical(prior))


def _draw(name: str, out: Path, path: Path | None) -> None:
    from slider_jax.channels import CHANNELS
    from slider_jax.cli.progress import Progress
    from slider_jax.experiment.load import load
    from slider_jax.io.files import staged
    from slider_jax.simulation.effect_signature import (
        built_in_experiment,
        fingerprint,
        plot_fingerprint,
    )

    experiment = built_in_experiment() if path is None else load(path)
    with staged(out) as stage:
        with Progress(name, "step") as progress:
            found = fingerprint(experiment, name, progress.to)
        plot_fingerprint(found, stage / f"{name}.png")
    print(explanation(name))
    print("\nchange over the stride, rms")
    for trace in found.traces:
        rms = found.rms(trace)
        said = [
            f"{x.label} {x.plot_factor * rms[x.column]:.4g} {x.plot_unit}"
            for x in CHANNELS.values()
            if rms[x.column]
        ]
        print(f"  {trace.label}: {'; '.join(said) or 'none'}")
    print(f"{name}.png is in {out}")
