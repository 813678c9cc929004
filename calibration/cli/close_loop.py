"""`slider close-loop`: what a model lacks, from measured trials or from the rig's logs."""

import json
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import tyro

from slider_jax.cli.options import Folder, ModelFile
from slider_jax.errors import InputError


def close_loop(
    inputs: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="EXPERIMENT.toml | LOG.txt ...", name="inputs"),
    ],
    out: Folder,
    model: ModelFile = None,
) -> None:
    """Calibrate, find the residual, trace it to an effect the model lacks, add it, report.

    Writes DIR/report.html (to read), DIR/report.json (to process) and DIR/model.toml (the
    calibrated model with what was found, for `slider simulate --model`). A run that was stopped
    goes on where it was when it is started again.

    Args:
        inputs: an experiment file (.toml), its measured trials beside it; or five or more pressure
            logs of the rig, at different frequencies.
        out: folder for the results; made if missing, files of the same name are replaced.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
    """
    from calibration.discrepancy.page import loop_page
    from calibration.discrepancy.report import error_lines, loop_model_toml, parameter_lines
    from calibration.inference.cache import input_settings as made_from, resumable
    from slider_jax.experiment.load import Experiment
    from slider_jax.io.files import staged, write_json, write_text

    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - begun:5.0f} s  {text}", file=sys.stderr, flush=True)

    def seconds() -> float:
        return time.monotonic() - begun

    given = _logs(inputs) if _are_logs(inputs, model) else _experiment(inputs[0], model)
    folder = given.folder if isinstance(given, Experiment) else None
    files = (*inputs, *([model] if model else []))
    with resumable(out, made_from(files, folder)) as memo:
        _tell_what_is_replaced(out)
        of = _of_experiment if isinstance(given, Experiment) else _of_logs
        outcome, told = of(given, inputs, memo, say, seconds)
        with staged(out) as stage:
            write_json(stage / "report.json", told)
            write_text(stage / "model.toml", loop_model_toml(outcome))
            write_text(stage / "report.html", loop_page(outcome, told))
    print("\n".join([told["said"], *parameter_lines(told), *error_lines(told)]))
    if told["next_experiment"]:
        print(f"Next: {told['next_experiment']['said']}")
    print(f"report.html, report.json and model.toml are in {out}", file=sys.stderr)


def _are_logs(inputs: tuple[Path, ...], model: Path | None) -> bool:
    if not inputs:
        raise InputError("inputs: nothing given; allowed an experiment file or logs")
    tables = [path for path in inputs if path.suffix == ".toml"]
    if not tables:
        if model is not None:
            raise InputError(f"--model {model}: given with logs; allowed with an experiment file")
        return True
    if len(inputs) > 1:
        raise InputError(
            f"inputs: given {', '.join(map(str, inputs))}; "
            "allowed one experiment file, or logs alone"
        )
    return False


def _tell_what_is_replaced(out: Path) -> None:
    try:
        told = json.loads((out / "report.json").read_text())["input"]
        of = told["path"] if "path" in told else f"{len(told['logs'])} logs"
    except (OSError, ValueError, KeyError, TypeError):
        return
    print(f"{out} holds the report on {of}: replaced when this run ends", file=sys.stderr)


def _experiment(path: Path, model: Path | None):
    from slider_jax.experiment.load import load

    return load(path, model)


def _logs(paths: tuple[Path, ...]):
    from calibration.cli.calibrate import refuse_twins
    from calibration.pressure_logs.read import read_log

    refuse_twins(paths)
    return [read_log(path) for path in paths]


def _of_experiment(experiment, inputs, memo, say, seconds) -> tuple[Any, dict[str, Any]]:
    from calibration.discrepancy.close_loop import close_loop_on_trials
    from calibration.discrepancy.report import loop_record
    from calibration.experiment_design.next_experiment import next_experiment
    from slider_jax.io.files import input_file

    outcome = close_loop_on_trials(experiment, progress=say, memo=memo)
    following = next_experiment(outcome, say)
    return outcome, loop_record(outcome, seconds(), input_file(inputs[0]), following)


def _of_logs(logs, inputs, memo, say, seconds) -> tuple[Any, dict[str, Any]]:
    from calibration.pressure_logs.close_loop import close_loop_on_logs, log_report

    outcome = close_loop_on_logs(logs, progress=say, memo=memo)
    say("simulating what this changes for thrust")
    return outcome, log_report(outcome, logs, seconds)
