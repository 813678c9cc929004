"""`slider effects matrix`: predicts the detection limits of effects before an experiment."""

import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from slider_jax.cli.options import Folder, ModelFile, Names, Range
from slider_jax.cli.progress import timed_printer
from slider_jax.errors import InputError, refuse_unknown


def effects_matrix(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    out: Folder,
    only: Names = (),
    separate: Names = (),
    frequency: Range = None,
    amplitude: Range = None,
    phase: Range = None,
    tow_speed: Range = None,
    model: ModelFile = None,
) -> None:
    """Predicts which effects an experiment can detect, and between which it can discriminate.

    The command works before any trial is measured. It writes the detection limits of the effects to
    DIR/matrix.json and DIR/matrix.png. With --separate, the command also searches for the trial
    that best discriminates between the given effects, and writes this trial to DIR/matrix.json and
    DIR/next_trial.toml. An interrupted run resumes when you repeat the command.

    Args:
        experiment: experiment file (.toml). Measured trials in its folder are used if they exist.
        out: folder for the results; created if missing. Files of the same name are replaced.
        only: names of the effects (default: the effects of --separate, or else all effects).
        separate: names of two or more effects between which the next trial must discriminate
            (default: none).
        frequency: lowest and highest frequency of the next trial, in Hz (default: the range in the
            experiment's trials, widened by 10 %).
        amplitude: lowest and highest amplitude of the next trial in Pa (default: as for frequency).
        phase: lowest and highest phase of the last chamber, as a fraction of a period (default: as
            for frequency).
        tow_speed: lowest and highest tow speed, in m/s (default: as for frequency).
        model: TOML file. Its keys of [robot] and [parameters] replace the experiment's keys, and
            its [[effects]] are added.
    """
    from calibration.experiment_design.detectability import detectability_matrix
    from calibration.experiment_design.detectability_report import (
        detectability_record,
        matrix_table,
        plot_matrix,
    )
    from calibration.experiment_design.trial_search import TrialLimits, limits_of
    from calibration.inference.cache import input_settings, resumable
    from calibration.model.extended import candidate_effects
    from slider_jax.effects.library import LIBRARY
    from slider_jax.experiment.load import load
    from slider_jax.io.files import input_file, staged, write_json, write_text

    candidates = candidate_effects()
    excluded = ", ".join(name for name in LIBRARY if name not in candidates)
    for option, names in (("--only", only), ("--separate", separate)):
        refuse_unknown(
            option, names, candidates, f"the names that slider effects lists, except {excluded}"
        )
    if separate and len(set(separate)) < 2:
        raise InputError("--separate: given one effect; allowed two or more; add another effect")
    given = dict(zip(TrialLimits._fields, (frequency, amplitude, phase, tow_speed), strict=True))
    for name, limits in given.items():
        if limits is not None and not separate:
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{option}: works only with --separate; use both or neither option")
    loaded = load(experiment, model)
    within = limits_of(loaded, given) if separate else None
    progress = timed_printer()
    files = (experiment, *([model] if model else []))
    with resumable(out, input_settings(files, loaded.folder)) as memo:
        progress("compiling")
        chosen = tuple(dict.fromkeys((*only, *separate))) or None
        found = detectability_matrix(loaded, chosen, progress, memo=memo)
        record = detectability_record(found, input_file(experiment))
        if within is not None:
            names = tuple(dict.fromkeys(separate))
            record["next_trial"] = _next_trial(found, names, within, progress)
        with staged(out) as stage:
            if within is not None:
                write_text(stage / "next_trial.toml", record["next_trial"]["toml"])
            write_json(stage / "matrix.json", record)
            plot_matrix(found, stage / "matrix.png")
    print(matrix_table(found))
    written = "matrix.json and matrix.png"
    if within is not None:
        print("\n" + _next_trial_text(record["next_trial"]))
        written = "matrix.json, matrix.png and next_trial.toml"
    print(f"{written} are in {out}", file=sys.stderr)


def _next_trial(found: Any, names: tuple[str, ...], limits: Any, progress) -> Any:
    from calibration.experiment_design.detectability import effects_at_limits
    from calibration.experiment_design.pair_distance import separating_trial

    information, before, indices, sizes = effects_at_limits(found, names)
    failed = [n for n in names if not np.all(np.isfinite(sizes[n]))]
    if failed:
        raise InputError(
            f"--separate {failed[0]}: the simulation of this effect at its detection limit fails "
            "in this experiment; omit the effect"
        )
    return separating_trial(information, before, indices, sizes, limits, progress=progress)


def _next_trial_text(record: dict[str, Any]) -> str:
    lines = [record["said"], "Prediction for effects at their detection limits, before -> after:"]
    for x in record["pairs"]:
        lines.append(
            f"  {x['first']}, {x['second']}: |cos| {x['cos_before']:.3f} -> {x['cos_after']:.3f}, "
            f"{x['sigmas_before']:.1f} -> {x['sigmas_after']:.1f} standard deviations"
        )
    return "\n".join([*lines, "", record["toml"].rstrip()])
