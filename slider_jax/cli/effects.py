"""`slider effects`: lists the library's effects, or shows how one effect changes the readings."""

import inspect
from pathlib import Path
from textwrap import indent
from typing import Annotated

import tyro

from slider_jax.cli.options import MaybeFolder
from slider_jax.effects import Effect, Prior
from slider_jax.effects.check import PLACES
from slider_jax.effects.library import LIBRARY
from slider_jax.errors import InputError, did_you_mean

NameArgument = Annotated[
    tyro.conf.Positional[str | None], tyro.conf.arg(metavar="NAME", help_behavior_hint="")
]
ExperimentFile = Annotated[
    Path | None, tyro.conf.arg(metavar="EXPERIMENT.toml", help_behavior_hint="")
]


def list_effects(
    name: NameArgument = None, out: MaybeFolder = None, experiment: ExperimentFile = None
) -> None:
    """Lists the effects that a model may contain, or explains one effect.

    Without NAME, the command lists all effects, grouped by the place in the model where they act.
    The list shows the prior range of each parameter and the sensors that the effect changes. With
    NAME, the command prints the equation, the source and the prior ranges of one effect. With
    --out, the command also draws DIR/NAME.png. This figure shows how the readings of one steady
    stride change if a parameter of the effect is at the end of the parameter's prior range.

    Args:
        name: name of the effect to explain (default: list all effects).
        out: folder for the figure; created if missing. An existing figure is replaced (default: no
            figure).
        experiment: experiment file (.toml); the figure shows the first trial of this file (default:
            the built-in robot at 4.8 Hz).
    """
    if name is None:
        for option, given in {"--out": out, "--experiment": experiment}.items():
            if given is not None:
                raise InputError(f"{option}: needs the NAME of an effect; add this NAME")
        print(listing())
        return
    if name not in LIBRARY:
        near = did_you_mean(name, (*LIBRARY, "matrix"))  # `slider effects matrix` is a command
        raise InputError(f"NAME: given {name!r}; allowed are the names of `slider effects`{near}")
    if experiment is not None and out is None:
        raise InputError("--experiment: needs a folder for the figure; add --out DIR")
    changes = [] if out is None else _draw(name, out, experiment)
    print("\n".join([explanation(name), *changes]))


def place_of(kind: type[Effect]) -> type[Effect]:
    """Returns the place of the model at which an effect acts."""
    return next(place for place in PLACES if issubclass(kind, place))


def listing() -> str:
    """Returns the list of all effects, grouped by place."""
    width = max(map(len, LIBRARY))
    lines = [f"{len(LIBRARY)} effects; `slider effects NAME` explains one effect"]
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
    """Returns an effect's docstring, its priors, and values halfway from null to prior bound."""
    from slider_jax.simulation.effect_signature import typical_size

    kind = LIBRARY[name]
    lines = [
        f"{name}: {kind.title}",
        "",
        indent(inspect.getdoc(kind) or "", "  "),
        "",
        f"place:   {_first_line(place_of(kind))}",
        f"sensors: {', '.join(kind.sensors)}",
        *([f"acts on: {', '.join(kind.segments)}"] if kind.segments else []),
        "",
        "parameters",
    ]
    priors = kind.priors()
    lines += _table({key: (_range(prior), prior.why) for key, prior in priors.items()})
    if kind.shapes():
        lines += ["", "shape parameters (no influence while the effect vanishes)"]
        lines += _table({key: (_shape_range(x), x.why) for key, x in kind.shapes().items()})
    lines += ["", "example for an experiment or model file", f'  [[effects]]\n  name = "{name}"']
    examples = {key: 0.5 * (prior.null + typical_size(prior)) for key, prior in priors.items()}
    return "\n".join([*lines, *(f"  {key} = {value:.3g}" for key, value in examples.items())])


def _first_line(place: type[Effect]) -> str:
    return (inspect.getdoc(place) or "").splitlines()[0].rstrip(".")


def _range(prior: Prior) -> str:
    unit = "" if prior.unit == "-" else f" {prior.unit}"
    null = "" if prior.null == 0.0 else f", no effect at {prior.null:g}"
    return f"{prior.low:g} to {prior.high:g}{unit}{null}"


def _shape_range(shape: Prior) -> str:
    unit = "" if shape.unit == "-" else f" {shape.unit}"
    return f"{shape.low:g} to {shape.high:g}{unit}, default {shape.null:.4g}"


def _table(rows: dict[str, tuple[str, str]]) -> list[str]:
    """Returns one aligned line for each parameter: its name, its range and the reason."""
    first, second = max(map(len, rows)), max(len(span) for span, _ in rows.values())
    return [f"  {key:<{first}}  {span:<{second}}  {why}" for key, (span, why) in rows.items()]


def _draw(name: str, out: Path, path: Path | None) -> list[str]:
    """Writes the figure of an effect and returns text lines with the changes of the readings."""
    from slider_jax.cli.progress import Progress
    from slider_jax.experiment.load import load
    from slider_jax.io.files import staged
    from slider_jax.simulation.effect_signature import (
        built_in_experiment,
        effect_signature,
        plot_signature,
    )

    experiment = built_in_experiment() if path is None else load(path)
    with staged(out) as stage:
        with Progress(name, "step") as progress:
            found = effect_signature(experiment, name, progress.to)
        plot_signature(found, stage / f"{name}.png")
    lines = ["", "rms change of the readings in this stride"]
    for trace in found.traces:
        rms = found.rms(trace)
        changes = [
            f"{x.label} {x.plot_factor * rms[x.column]:.4g} {x.plot_unit}"
            for x in found.run.prepared.channels.values()
            if rms[x.column]
        ]
        lines.append(f"  {trace.label}: {'; '.join(changes) or 'none'}")
    return [*lines, f"wrote {name}.png to {out}"]
