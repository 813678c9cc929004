"""Trial after trial until it is settled what a model lacks: capture, close the loop, choose next.

Where the trials come from is not known here: `capture` may be a rig, a simulated one, or a program.
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
from slider_jax.io.files import input_file, write_json, write_text

Capture = Callable[[tuple[Trial, ...]], None]
"""Makes the files of these trials, in the experiment's folder."""
Say = Callable[[str], None]
BUDGET = 12


@dataclass(frozen=True)
class CampaignRound:
    """What the loop found with so many trials."""

    trials: int
    verdict: str
    effects: list[str]
    said: str
    next: str
    """What is to be measured next and why, in a sentence."""


@dataclass(frozen=True)
class Campaign:
    """All rounds, and the last one's outcome and report. `settled`: more trials are needless."""

    rounds: list[CampaignRound]
    outcome: LoopOutcome
    report: dict[str, Any]
    settled: bool


def verdict_is_final(outcome: LoopOutcome, following: dict[str, Any]) -> bool:
    """Whether no further trial can change the verdict in kind.

    A class is settled once no trial within the limits is predicted to make it smaller.
    Something that is not explained, or on which trials do not agree, is not settled.
    """
    if outcome.verdict in (NOTHING, IDENTIFIED):
        return True
    return outcome.verdict == CLASS and following.get("times", 1) is None


def campaign(
    path: Path,
    capture: Capture,
    out: Path,
    budget: int = BUDGET,
    limits: Callable[[Experiment], TrialLimits] | None = None,
    say: Say = lambda text: None,
    close: Callable[..., LoopOutcome] = close_loop_on_trials,
) -> Campaign:
    """Closes the loop on the experiment `path` again and again, at most `budget` trials in all.

    Trials of the file that are not measured yet are captured first; each that is chosen, within
    `limits` of the experiment, is added to the file. `close` is `close_loop`, or that with other
    candidates or meshes. `out`/round_NN.json is each round's report. What was stopped goes on.
    Raises `InputError` for a budget below what the experiment begins with.
    """
    experiment = load(path)
    if budget < len(experiment.trials):
        raise InputError.value(
            "budget", budget, f"{len(experiment.trials)} trials, with which it begins, or more"
        )
    out.mkdir(parents=True, exist_ok=True)
    rounds: list[CampaignRound] = []
    while True:
        experiment = load(path)
        missing = [t for t in experiment.trials if not (experiment.folder / t.file).exists()]
        if missing:
            say(f"capturing {', '.join(t.file for t in missing)}")
            capture(tuple(missing))
        count = len(experiment.trials)
        say(f"closing the loop on {count} trials")
        with resumable(out, input_settings((path,), experiment.folder)) as memo:
            outcome = close(experiment, progress=say, memo=memo, kept=_chosen(out))
            following = next_experiment(outcome, say, limits(experiment) if limits else None)
            told = loop_record(outcome, 0.0, input_file(path), following)
            write_json(out / f"round_{count:02d}.json", told)
        rounds.append(
            CampaignRound(
                count, outcome.verdict, list(outcome.effects), told["said"], following["said"]
            )
        )
        say(f"{count} trials: {told['said']}")
        done = verdict_is_final(outcome, following)
        if done or count >= budget or following["trial"] is None:
            return Campaign(rounds, outcome, told, done)
        say(f"next: {following['said']}")
        write_text(path, path.read_text().rstrip() + "\n\n" + following["toml"])


def _chosen(out: Path) -> list[str]:
    """Files of the trials that the rounds before chose: what they are to tell must be searched."""
    reports = [json.loads(path.read_text()) for path in sorted(out.glob("round_*.json"))]
    trials = [report["next_experiment"]["trial"] for report in reports]
    return [trial["file"] for trial in trials if trial is not None]
