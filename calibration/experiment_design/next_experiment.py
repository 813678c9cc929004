"""Proposes the next trial to measure after a verdict of the loop.

After "partly_explained", "unexplained" and "inconclusive", the proposal repeats the trial with the
largest residual. After "class", the proposed trial discriminates between the effects of the class.
After all other verdicts, the proposed trial narrows the widest interval of a parameter. If the
verdict is "inconclusive" because the added effects may be absent, the proposed trial narrows the
widest interval of their sizes.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome
from calibration.discrepancy.rounds import effect_entries, scoring_entries
from calibration.discrepancy.verdict import CLASS, INCONCLUSIVE, PARTLY, UNEXPLAINED
from calibration.experiment_design.discriminate import discriminating_trial
from calibration.experiment_design.information import (
    ChannelInformation,
    SensorModel,
    TrialInformation,
    information,
)
from calibration.experiment_design.trial_search import (
    SearchEffort,
    TrialLimits,
    TrialSearch,
    limits_of,
    next_trial_record,
    trial_text,
    unused_file_name,
)
from calibration.inference.gauss_newton import inverse
from calibration.inference.problem import TankProblem, summed
from calibration.inference.uncertainty import errors_of_discretisation
from calibration.measurements.records import Record
from slider_jax.errors import InputError, SolverError

LOOP_EFFORT = SearchEffort(spread=12, rounds=0)
"""Effort of the trial search at the end of the loop. The default effort would take too long."""
Progress = Callable[[str], None]


def next_experiment(
    outcome: LoopOutcome,
    progress: Progress = lambda text: None,
    limits: TrialLimits | None = None,
    effort: SearchEffort = LOOP_EFFORT,
) -> dict[str, Any]:
    """Returns the record of the next experiment for report.json; its "trial" may be None.

    `limits` are the trial's limits (default: the widened ranges of the experiment's trials).
    """
    uncertain = outcome.verdict == INCONCLUSIVE and outcome.chosen.converged and outcome.statuses
    if outcome.verdict in (PARTLY, UNEXPLAINED, INCONCLUSIVE) and not uncertain:
        return _again(outcome)
    try:
        within = limits_of(outcome.experiment) if limits is None else limits
        if outcome.verdict == CLASS:
            return _discriminating(outcome, within, effort, progress)
        return _narrowing(outcome, within, effort, progress, bool(uncertain))
    except (InputError, SolverError) as error:
        return _none(f"No trial is proposed: {error}")


def _none(text: str) -> dict[str, Any]:
    return {"purpose": None, "said": text, "trial": None, "toml": ""}


def _again(outcome: LoopOutcome) -> dict[str, Any]:
    """Returns the record that proposes to repeat the trial with the largest residual or pattern."""
    records, floor = _fitted(outcome), outcome.search.settings.noise_floor
    above = {c: x for c, x in outcome.excess.items() if x.above(floor)} or outcome.excess
    channel, x = max(above.items(), key=lambda item: np.nanmax(item[1].trials))
    worst = int(np.nanargmax(x.trials))
    if x.all <= floor and x.patterns:
        files = [r.trial.file for r in records]
        worst = files.index(max(x.patterns, key=lambda p: p.line).trial)
    trial = records[worst].trial
    again = trial.model_copy(update={"file": unused_file_name(outcome.experiment)})
    text = (
        f"Repeat {trial.file} ({trial_text(trial)}): the residual's mean square in {channel} is "
        f"{x.trials[worst]:.1f} times the mean square of noise. If the repetition has the same "
        "residual, the cause is in the tank. If not, the set-up of the first trial was the cause."
    )
    return next_trial_record("repeat", text, again)


def _fitted(outcome: LoopOutcome) -> list[Record]:
    return [outcome.problem.records[i] for i in outcome.used_trials]


def _prediction(
    outcome: LoopOutcome, theta: np.ndarray, chosen: np.ndarray, other: np.ndarray | None = None
) -> TrialInformation:
    names, problem = tuple(effect_entries(outcome.entries)), outcome.problem
    assert isinstance(problem, TankProblem)
    files = [r.trial.file for r in problem.records]
    noise = {(files[i], channel): x for (i, channel), x in problem.noise.items()}
    sensing = SensorModel.of(outcome.experiment, _fitted(outcome), noise)
    return TrialInformation(
        outcome.experiment, names, theta, chosen, sensing, {}, problem.mesh, problem.memo, other
    )


def _discriminating(
    outcome: LoopOutcome, limits: TrialLimits, effort: SearchEffort, progress: Progress
) -> dict[str, Any]:
    """Returns the best trial for the first class that a trial can reduce, or for the last class."""
    found = _none("No trial is proposed: no alternative can be fitted instead of a chosen effect.")
    last, trials = outcome.search.final, [r.trial for r in _fitted(outcome)]
    for round_ in outcome.search.rounds:
        known = [n for n in round_.equivalent if n in round_.alternatives]
        fits = {n: round_.alternatives[n].fit for n in known}
        if not round_.chosen or not fits:
            continue
        predictions = {
            n: (
                _prediction(outcome, x.theta, x.free, last.theta),
                _prediction(outcome, last.theta, last.free, x.theta),
            )
            for n, x in fits.items()
        }
        progress(f"searching the trial that discriminates {round_.chosen} from {', '.join(fits)}")
        found = discriminating_trial(
            round_.chosen, predictions, last.inflation, trials, limits, effort, progress
        )
        if found["times"] is not None:
            break
    return found


def _narrowing(
    outcome: LoopOutcome,
    limits: TrialLimits,
    effort: SearchEffort,
    progress: Progress,
    only_sizes: bool,
) -> dict[str, Any]:
    """Returns the trial that narrows the widest interval, or the widest interval of a size."""
    final, errors = outcome.final, outcome.final.errors
    floor = errors_of_discretisation(final, outcome.entries)
    scored = scoring_entries(outcome.entries)
    sizes = np.concatenate([scored[x.name] for x in outcome.statuses]) if only_sizes else final.free
    ratio = np.where(np.isin(final.free, sizes), errors / np.maximum(floor, 1e-300), 0.0)
    widest = int(np.argmax(ratio))
    if errors[widest] <= floor[widest]:
        intervals = "the intervals of the added effects" if only_sizes else "every interval"
        return _none(
            "No trial is proposed: the model-discretisation discrepancy is the larger part of "
            f"{intervals}, and more data do not reduce this discrepancy."
        )
    f = _prediction(outcome, final.theta, final.free)
    p, before = outcome.entries[final.free[widest]], summed(final.blocks)[0]

    def goal(channels: list[list[ChannelInformation]]) -> float:
        return -float(inverse(before + information(channels[0]))[widest, widest])

    progress(f"searching the trial that narrows the interval of {p.label}")
    best = TrialSearch([f], goal, limits).run(effort, progress)
    wider = np.broadcast_to(np.maximum(final.widening, final.correlation), errors.shape)[widest]
    after = float(wider * np.sqrt(final.inflation * -best.value))
    unit = "" if p.prior.unit == "-" else f" {p.prior.unit}"
    text = (
        f"{trial_text(best.trial)} narrows the widest interval (parameter {p.label}) most: "
        f"the standard error due to noise falls from {errors[widest]:.2g} to {after:.2g}{unit}."
    )
    return next_trial_record("narrow", text, best.trial, limits) | {
        "parameter": p.label,
        "error_before": errors[widest],
        "error_after": after,
    }
