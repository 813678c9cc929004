"""`slider close-loop`: finds the effects that a model lacks, from measured trials or rig logs."""

import json
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import tyro

from slider_jax.cli.options import Folder, ModelFile, Names
from slider_jax.cli.progress import timed_printer
from slider_jax.errors import InputError, refuse_unknown


def close_loop(
    inputs: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(
            metavar="EXPERIMENT.toml | LOG.txt ...", name="inputs", help_behavior_hint="(required)"
        ),
    ],
    out: Folder,
    only: Names = (),
    without: Names = (),
    model: ModelFile = None,
) -> None:
    """Calibrates a model and finds the effects that the model lacks.

    The command fits the model and adds effects of the library that explain the residual. The
    command writes DIR/report.html (for people), DIR/report.json (for programs) and DIR/model.toml.
    The model file contains the fitted parameters and the added effects, for `slider simulate
    --model`. An interrupted run resumes when you repeat the command.

    Args:
        inputs: experiment file (.toml) with its measured trials in the same folder, or five or more
            pressure logs (.txt) of the rig at different frequencies.
        out: folder for the results; created if missing. Files of the same name are replaced.
        only: names of the candidate effects (default: the whole library).
        without: names of effects that are not candidates (default: none).
        model: TOML file. Its keys of [robot] and [parameters] replace the experiment's keys, and
            its [[effects]] are added.
    """
    from calibration.discrepancy.page import loop_page
    from calibration.discrepancy.report import (
        choice_sentence,
        error_lines,
        loop_model_toml,
        parameter_lines,
    )
    from calibration.inference.cache import input_settings, resumable
    from calibration.learning.report import learned_lines, learned_model_toml, learned_parts
    from slider_jax.experiment.load import Experiment, load
    from slider_jax.io.files import staged, write_json, write_text

    start, progress = time.monotonic(), timed_printer()

    def seconds() -> float:
        return time.monotonic() - start

    given = _logs(inputs) if _are_logs(inputs, model) else load(inputs[0], model)
    folder = given.folder if isinstance(given, Experiment) else None
    files = (*inputs, *([model] if model else []))
    close = _close_on_experiment if isinstance(given, Experiment) else _close_on_logs
    names = _candidates(given, only, without)
    choice = {"only": sorted(only), "without": sorted(without)}
    with resumable(out, input_settings(files, folder) | choice) as memo:
        _announce_replacement(out)
        outcome, record, learning = close(given, names, inputs, memo, progress, seconds)
        record["candidate_choice"] = choice | _counted(given, names)
        record["said"] = f"{record['said']} {choice_sentence(record['candidate_choice'])}".rstrip()
        with staged(out) as stage:
            write_json(stage / "report.json", record)
            model_toml, shown = loop_model_toml(outcome), None
            if learning is not None and learning.model is not None:
                model_toml = learned_model_toml(outcome, learning)
                shown = learned_parts(record["learned"], outcome.problem.all_channels)
            write_text(stage / "model.toml", model_toml)
            write_text(stage / "report.html", loop_page(outcome, record, shown))
    lines = [*parameter_lines(record), *error_lines(record), *learned_lines(record)]
    print("\n".join([record["said"], *lines]))
    if record["next_experiment"]:
        print(f"Next: {record['next_experiment']['said']}")
    print(f"report.html, report.json and model.toml are in {out}", file=sys.stderr)


def _are_logs(inputs: tuple[Path, ...], model: Path | None) -> bool:
    if not inputs:
        raise InputError("inputs: no file given; give an experiment file or five pressure logs")
    tables = [path for path in inputs if path.suffix == ".toml"]
    if not tables:
        if model is not None:
            raise InputError(f"--model {model}: not allowed with pressure logs; omit --model")
        return True
    if len(inputs) > 1:
        raise InputError(
            f"inputs: given {', '.join(map(str, inputs))}; "
            "allowed one experiment file, or only pressure logs"
        )
    return False


def _candidates(given: Any, only: tuple[str, ...], without: tuple[str, ...]) -> list[str]:
    """Returns the names of the candidate effects for an experiment or for logs `given`."""
    known = _known(given)
    for option, chosen in (("--only", only), ("--without", without)):
        listed = f"the names of the {len(known)} candidates; slider effects lists all effects"
        refuse_unknown(option, chosen, known, listed)
    names = [n for n in known if (n in only or not only) and n not in without]
    if not names:
        raise InputError("--only, --without: no candidate effect remains; give other names")
    return names


def _known(given: Any) -> list[str]:
    """Returns the names of all candidate effects for an experiment or for logs `given`."""
    from calibration.model.extended import candidate_effects
    from calibration.pressure_logs.problem import log_candidates

    return log_candidates() if isinstance(given, list) else candidate_effects()


def _counted(given: Any, names: list[str]) -> dict[str, int]:
    return {"tested": len(names), "known": len(_known(given))}


def _announce_replacement(out: Path) -> None:
    try:
        source = json.loads((out / "report.json").read_text())["input"]
        name = source["path"] if "path" in source else f"{len(source['logs'])} logs"
    except (OSError, ValueError, KeyError, TypeError):
        return
    print(f"{out}: this run will replace the existing report on {name}", file=sys.stderr)


def _logs(paths: tuple[Path, ...]):
    from calibration.cli.calibrate import refuse_same_names
    from calibration.pressure_logs.read import read_log

    refuse_same_names(paths)
    return [read_log(path) for path in paths]


def _close_on_experiment(
    experiment, names, inputs, memo, progress, seconds
) -> tuple[Any, dict[str, Any], Any]:
    from calibration.discrepancy.close_loop import close_loop_on_trials
    from calibration.discrepancy.report import loop_record
    from calibration.experiment_design.next_experiment import next_experiment
    from calibration.learning.learn import learn_terms
    from calibration.learning.report import learned_record, with_learned
    from slider_jax.io.files import input_file

    outcome = close_loop_on_trials(experiment, names, progress, memo=memo)
    learning = learn_terms(outcome, progress)
    outcome = outcome if learning is None else learning.outcome
    learned = None if learning is None else learned_record(learning, progress)
    at_floor = learning is not None and learning.reaches_floor  # the function proposes a trial
    following = None if at_floor else next_experiment(outcome, progress)
    record = loop_record(outcome, seconds(), input_file(inputs[0]), following)
    return outcome, with_learned(record, learned), learning


def _close_on_logs(logs, names, inputs, memo, progress, seconds) -> tuple[Any, dict[str, Any], Any]:
    from calibration.pressure_logs.close_loop import close_loop_on_logs, log_report

    outcome = close_loop_on_logs(logs, names, progress, memo)
    progress("simulating the thrust with and without the effects")
    return outcome, log_report(outcome, logs, seconds), None
