"""Captures trials, closes the loop and chooses the next trial, until the verdict is final.

The caller provides a function that runs trials on a rig, on a simulated rig or in another program.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.discrepancy.close_loop import LoopOutcome, close_loop_on_trials
from calibration.discrepancy.report import loop_record
from calibration.discrepancy.verdict import CLASS, IDENTIFIED, NOTHING
from calibration.experiment_design.next_experiment import next_experiment
from calibration.experiment_design.trial_search import TrialLimits
from calibration.inference.cache import input_settings, resumable
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, load
from slider_jax.experiment.schema import Trial
from slider_jax.io.files import input_file, refuse_changed_effect_files, write_json, write_text

Capture = Callable[[tuple[Trial, ...]], None]
"""Function that writes the files of the given trials to the experiment's folder."""
BUDGET = 12
"""Default limit on the number of trials in a campaign."""


@dataclass(frozen=True)
class Campaign:
    """The result of a campaign: all rounds, and the outcome of the last round."""

    rounds: list[dict[str, Any]]
    """For each round: number of trials, verdict, effects, and texts on verdict and next trial."""
    outcome: LoopOutcome
    """Outcome of the last round."""
    report: dict[str, Any]
    """Content of report.json of the last round."""
    settled: bool
    """Whether the verdict of the last round is final."""


def verdict_is_final(outcome: LoopOutcome, following: dict[str, Any]) -> bool:
    """Returns whether the campaign stops because of this verdict.

    "nothing_missing" and "identified" are final. "class" is final if no trial within the limits is
    predicted to exclude an effect of the class. All other verdicts are not final.
    """
    if outcome.verdict in (NOTHING, IDENTIFIED):
        return True
    return outcome.verdict == CLASS and following.get("times", 1) is None


def run_campaign(
    path: Path,
    capture: Capture,
    out: Path,
    budget: int = BUDGET,
    limits: Callable[[Experiment], TrialLimits] | None = None,
    progress: Callable[[str], None] = lambda text: None,
    close: Callable[..., LoopOutcome] = close_loop_on_trials,
) -> Campaign:
    """Closes the loop on the experiment file `path` repeatedly, with at most `budget` trials.

    Each round captures the trials in the file that are not yet measured, closes the loop with
    `close` and writes `out`/round_NN.json. The round then adds a trial within `limits` to the file.
    A repeated call resumes an interrupted campaign. Raises `InputError` if the budget is smaller
    than the number of trials in the file.
    """
    experiment = load(path)
    if budget < len(experiment.trials):
        raise InputError.value(
            "budget", budget, f"{len(experiment.trials)} (the experiment's trials) or more"
        )
    out.mkdir(parents=True, exist_ok=True)
    rounds = []
    while True:
        experiment = load(path)
        missing = [t for t in experiment.trials if not (experiment.folder / t.file).exists()]
        if missing:
            progress(f"capturing {', '.join(t.file for t in missing)}")
            capture(tuple(missing))
        count = len(experiment.trials)
        progress(f"closing the loop on {count} trials")
        with resumable(out, input_settings((path,), experiment.folder)) as memo:
            outcome = close(experiment, progress=progress, memo=memo, kept=_chosen(out))
            following = next_experiment(outcome, progress, limits(experiment) if limits else None)
            record = loop_record(outcome, 0.0, input_file(path), following)
            refuse_changed_effect_files()
            write_json(out / f"round_{count:02d}.json", record)
        rounds.append(
            {"trials": count, "verdict": outcome.verdict, "effects": list(outcome.effects)}
            | {"said": record["said"], "next": following["said"]}
        )
        progress(f"{count} trials: {record['said']}")
        done = verdict_is_final(outcome, following)
        if done or count >= budget or following["trial"] is None:
            return Campaign(rounds, outcome, record, done)
        progress(f"next: {following['said']}")
        write_text(path, path.read_text().rstrip() + "\n\n" + following["toml"])


def _chosen(out: Path) -> list[str]:
    """Returns the files of trials that earlier rounds chose. These trials must not be held out."""
    reports = [json.loads(path.read_text()) for path in sorted(out.glob("round_*.json"))]
    return [x["next_experiment"]["trial"]["file"] for x in reports if x["next_experiment"]["trial"]]
