"""`slider effects matrix`: what an experiment could find and separate, before any data."""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from slider_jax.cli.options import Folder, ModelFile, Range
from slider_jax.errors import InputError, did_you_mean

Names = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")]


def effects_matrix(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    out: Folder,
    effects: Names = (),
    separate: Names = (),
    frequency: Range = None,
    amplitude: Range = None,
    phase: Range = None,
    tow_speed: Range = None,
    model: ModelFile = None,
) -> None:
    """Say which effects an experiment could detect, from what size on, and which look alike.

    Nothing needs to be measured. A run that was stopped goes on where it was when it is started
    again. Writes DIR/matrix.json and DIR/matrix.png. With --separate, also
    which trial to run next to tell the effects named apart: in DIR/matrix.json, and as
    DIR/next_trial.toml to add to the experiment. The limits of that trial are those of the
    experiment's own trials, slightly widened, unless given.

    Args:
        experiment: the experiment file (.toml); measured trials beside it are not needed.
        out: folder for the results; made if missing, files of the same name are replaced.
        effects: the effects asked about, by default those of --separate, else all.
        separate: two or more effects that the next trial is to tell apart.
        frequency: lowest and highest frequency of that trial, Hz.
        amplitude: lowest and highest set pressure of that trial, Pa.
        phase: lowest and highest phase of the rear chamber of that trial, fraction of a period.
        tow_speed: lowest and highest tow speed of that trial, m/s.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
    """
    from calibration.experiment_design.detectability import detectability_matrix as matrix_of
    from calibration.experiment_design.detectability_report import (
        detectability_record,
        matrix_table,
        plot_matrix,
    )
    from calibration.experiment_design.trial_search import TrialLimits, limits_of
    from calibration.inference.cache import input_settings, resumable
    from slider_jax.experiment.load import load
    from slider_jax.io.files import input_file, staged, write_json, write_text

    _check("--effects", effects)
    _check("--separate", separate)
    if separate and len(set(separate)) < 2:
        raise InputError("--separate: given one effect; allowed two or more, to be told apart")
    given = dict(zip(TrialLimits._fields, (frequency, amplitude, phase, tow_speed), strict=True))
    for name, limits in given.items():
        if limits is not None and not separate:
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{option}: is a limit of the next trial; give --separate too")
    loaded = load(experiment, model)
    within = limits_of(loaded, given) if separate else None
    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - begun:5.0f} s  {text}", file=sys.stderr, flush=True)

    files = (experiment, *([model] if model else []))
    with resumable(out, input_settings(files, loaded.folder)) as memo:
        say("compiling")
        names = tuple(dict.fromkeys((*effects, *separate))) or None
        found = matrix_of(loaded, names, say, memo=memo)
        told = detectability_record(found, input_file(experiment))
        if within is not None:
            told["next_trial"] = _next(found, tuple(dict.fromkeys(separate)), within, say)
        with staged(out) as stage:
            if within is not None:
                write_text(stage / "next_trial.toml", told["next_trial"]["toml"])
            write_json(stage / "matrix.json", told)
            plot_matrix(found, stage / "matrix.png")
    print(matrix_table(found))
    written = "matrix.json and matrix.png"
    if within is not None:
        print("\n" + _said(told["next_trial"]))
        written = "matrix.json, matrix.png and next_trial.toml"
    print(f"{written} are in {out}", file=sys.stderr)


def _check(option: str, names: tuple[str, ...]) -> None:
    from calibration.model.extended import candidates

    allowed = candidates()
    for name in names:
        if name not in allowed:
            raise InputError(
                f"{option}: given {name!r}; allowed the names that slider effects lists, without "
                f"gravity{did_you_mean(name, allowed)}"
            )


def _next(found: Any, names: tuple[str, ...], within: Any, say: Callable[[str], None]) -> Any:
    from calibration.experiment_design.detectability import at_limits
    from calibration.experiment_design.pair_distance import separate

    f, before, members, sizes = at_limits(found, names)
    unseen = [n for n in names if not np.all(np.isfinite(sizes[n]))]
    if unseen:
        raise InputError(
            f"--separate {unseen[0]}: cannot be simulated in this experiment at the size that is "
            "tried; leave it out"
        )
    return separate(f, before, members, sizes, within, progress=say)


def _said(told: dict[str, Any]) -> str:
    lines = [told["said"], "expected, each at the size from which this experiment would find it:"]
    for x in told["pairs"]:
        lines.append(
            f"  {x['first']}, {x['second']}: |cos| {x['cos_before']:.3f} -> {x['cos_after']:.3f}, "
            f"{x['sigmas_before']:.1f} -> {x['sigmas_after']:.1f} standard deviations apart"
        )
    return "\n".join([*lines, "", told["toml"].rstrip()])
