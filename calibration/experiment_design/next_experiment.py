"""What to measure next, once the loop has said what it found.

A class asks for the trial that makes it smaller; a residual that nobody explains or that is left
beside a class, or trials that do not agree, for the worst condition once more; all else for the
trial that narrows the widest interval.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome
from calibration.discrepancy.rounds import effect_entries
from calibration.discrepancy.verdict import CLASS, INCONCLUSIVE, UNEXPLAINED
from calibration.experiment_design.discriminate import split_class
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
    as_table,
    free_name,
    limits_of,
    trial_text,
    trial_toml,
)
from calibration.inference.gauss_newton import inverse
from calibration.inference.problem import TankProblem, summed
from calibration.inference.uncertainty import BASE_DISCREPANCY, EFFECT_DISCREPANCY
from calibration.measurements.records import Record
from slider_jax.errors import InputError, SolverError

LOOP = SearchEffort(spread=12, rounds=1)
"""Trials that are tried at the end of the loop, which has minutes in all."""
Say = Callable[[str], None]


def next_experiment(
    outcome: LoopOutcome,
    progress: Say = lambda text: None,
    limits: TrialLimits | None = None,
    effort: SearchEffort = LOOP,
) -> dict[str, Any]:
    """What to measure next, as report.json says it: purpose, a sentence, and a trial or None.

    `limits` are those of the experiment's own trials by default.
    """
    left = any(x.all > outcome.search.settings.noise_floor for x in outcome.excess_after.values())
    if outcome.verdict in (UNEXPLAINED, INCONCLUSIVE) or (outcome.verdict == CLASS and left):
        return _again(outcome)
    try:
        within = limits_of(outcome.experiment) if limits is None else limits
        if outcome.verdict == CLASS:
            return _split(outcome, within, effort, progress)
        return _narrowed(outcome, within, effort, progress)
    except (InputError, SolverError) as error:
        return _none(f"No trial is proposed: {error}")


def _none(said: str) -> dict[str, Any]:
    return {"purpose": None, "said": said, "trial": None, "toml": ""}


def _again(outcome: LoopOutcome) -> dict[str, Any]:
    """The trial whose residual stands highest above its noise, once more."""
    records = _searched(outcome)
    channel, x = max(outcome.excess_after.items(), key=lambda item: np.nanmax(item[1].trials))
    worst = int(np.nanargmax(x.trials))
    trial = records[worst].trial
    again = trial.model_copy(update={"file": free_name(outcome.experiment)})
    said = (
        f"Repeat {trial.file} ({trial_text(trial)}), where {channel} is furthest from the model: "
        f"its mean square is {x.trials[worst]:.1f} times the noise's. A cause in the tank leaves "
        "the same residual again; one of that day's setting does not."
    )
    return {"purpose": "repeat", "said": said, "trial": as_table(again), "toml": trial_toml(again)}


def _searched(outcome: LoopOutcome) -> list[Record]:
    return [r for i, r in enumerate(outcome.problem.records) if i not in outcome.held]


def _prediction(
    outcome: LoopOutcome, theta: np.ndarray, chosen: np.ndarray, other: np.ndarray | None = None
) -> TrialInformation:
    names, problem = tuple(effect_entries(outcome.entries)), outcome.problem
    assert isinstance(problem, TankProblem)
    sensing = SensorModel.of(outcome.experiment, _searched(outcome))
    return TrialInformation(
        outcome.experiment, names, theta, chosen, sensing, {}, problem.mesh, problem.memo, other
    )


def _split(
    outcome: LoopOutcome, limits: TrialLimits, effort: SearchEffort, progress: Say
) -> dict[str, Any]:
    """For the first class that a trial can make smaller, or else the last one."""
    found = _none("No trial is proposed: none of the rivals can be fitted in the place of another.")
    last, trials = outcome.search.final, [r.trial for r in _searched(outcome)]
    for this in outcome.search.rounds:
        fits = {n: this.alternatives[n].fit for n in this.equivalent if n in this.alternatives}
        if not this.chosen or not fits:
            continue
        ways = {
            n: (
                _prediction(outcome, x.theta, x.free, last.theta),
                _prediction(outcome, last.theta, last.free, x.theta),
            )
            for n, x in fits.items()
        }
        progress(f"what the next trial could say of {this.chosen} and {', '.join(fits)}")
        found = split_class(this.chosen, ways, last.inflation, trials, limits, effort, progress)
        if found["times"] is not None:
            break
    return found


def _narrowed(
    outcome: LoopOutcome, limits: TrialLimits, effort: SearchEffort, progress: Say
) -> dict[str, Any]:
    final, entries = outcome.final, outcome.entries
    errors = final.errors
    own = [entries[i] for i in final.free]
    floor = np.array(
        [
            (EFFECT_DISCREPANCY if p.effect else BASE_DISCREPANCY[p.name]) * abs(final.theta[i])
            for i, p in zip(final.free, own, strict=True)
        ]
    )
    widest = int(np.argmax(errors / np.maximum(floor, 1e-300)))
    if errors[widest] <= floor[widest]:
        return _none(
            "No trial is proposed: what two correct programs differ by is the larger part of every "
            "interval, so more of such data would not narrow one."
        )
    f = _prediction(outcome, final.theta, final.free)
    p, before = own[widest], summed(final.blocks)[0]

    def goal(channels: list[list[ChannelInformation]]) -> float:
        return -float(inverse(before + information(channels[0]))[widest, widest])

    progress(f"what the next trial could say of {p.label}")
    best = TrialSearch([f], goal, limits).run(effort, progress)
    after = float(np.sqrt(final.inflation * -best.value))
    unit = "" if p.prior.unit == "-" else f" {p.prior.unit}"
    said = (
        f"{trial_text(best.trial)} narrows the widest interval most, that of {p.label}: its "
        f"standard error by noise from {errors[widest]:.2g} to {after:.2g}{unit}."
    )
    return {
        "purpose": "narrow",
        "said": said[0].upper() + said[1:],
        "trial": as_table(best.trial),
        "toml": trial_toml(best.trial),
        "parameter": p.label,
        "error_before": errors[widest],
        "error_after": after,
        "limits": limits._asdict(),
    }
