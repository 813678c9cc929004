"""Do C_d and m_a depend on the drive frequency, and as the paper's ramp has it?

Every way of `calibration.identification.parameter_ties` is fitted to all trials. They are compared
on what none of them
saw: each frequency is left out in turn, the vector is fitted to the others (by the linearisation at
the optimum), and the trials left out are simulated with it; values by frequency are interpolated
from the neighbours'. The simplest way within one standard error of the best is chosen.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calibration.discrepancy.scores import least_squares_step
from calibration.experiment_design.parameter_trial import (
    MeasuredInformation,
    Proposal,
    best_trial,
    feasible_trials,
)
from calibration.identification import parameter_ties as layouts
from calibration.identification.parameter_ties import CONSTANT, EACH, PAPER, RAMP, ParameterTies
from calibration.inference.gauss_newton import Fit, fit_gauss_newton, marginal_information
from calibration.inference.problem import FAILED, TankProblem, summed
from calibration.inference.uncertainty import (
    confidence_interval,
    determined,
    hausman_check,
    value_by_variation,
)
from calibration.model.extended import Parameter
from calibration.model.predict import COARSE, Resolution
from slider_jax.errors import InputError, did_you_mean
from slider_jax.experiment.load import Experiment

LEAST_FREQUENCIES = 4
"""For a comparison on frequencies that were left out."""


class Way(NamedTuple):
    """One layout, fitted."""

    layout: ParameterTies
    fit: Fit
    left_out: np.ndarray | None
    """(frequencies,) sums of squares of the white residuals of each when it was left out."""


class ByFrequency(NamedTuple):
    """What the comparison found."""

    experiment: Experiment
    entries: list[Parameter]
    """Of one trial."""
    problem: TankProblem
    """Without maps."""
    frequencies: np.ndarray
    """(frequencies,) [Hz]"""
    place: np.ndarray
    """(trials,) of each trial's frequency."""
    ways: dict[str, Way]
    chosen: str | None
    """Name of the layout that explains the data best, or None for too few frequencies."""
    advice: dict[int, Proposal]
    """A trial for every entry of the values by frequency that the data do not determine."""

    @property
    def used(self) -> Way:
        """The way that model.toml takes: the chosen one, constant values where none is."""
        return self.ways[self.chosen or CONSTANT]


def compare(
    experiment: Experiment,
    entries: list[Parameter],
    problem: TankProblem,
    begin: Fit,
    each: Sequence[str] = layouts.FOLLOWS,
    progress: Callable[[str], None] = lambda text: None,
    coarse: Resolution = COARSE,
) -> ByFrequency:
    """Fit all ways from the fit of constant values `begin` on, and compare them.

    `each` are labels of the parameters that may differ from frequency to frequency. Raises
    `InputError` for an unknown one, for a trial without a frequency, or for one frequency only.
    """
    check_labels(each, entries)
    at, place = layouts.frequencies([r.trial for r in problem.records])
    if len(at) < 2:
        raise InputError(
            f"--per-frequency: all trials are driven at {at[0]:g} Hz; leave the option out"
        )
    white = problem.whiteners(begin.predicted)
    theta = begin.theta
    plans = [layouts.constant(entries, theta, len(place))]
    if set(layouts.FOLLOWS) <= set(each):
        plans.append(layouts.paper(entries, theta, at, place))
        if layouts.sees_the_ramp(at):
            plans.append(layouts.ramp(entries, theta, at, place))
    plans.append(layouts.per_frequency(entries, theta, at, place, each))
    ways = {}
    for plan in plans:
        progress(f"fitting {plan.name.replace('_', ' ')} values")
        laid = replace(problem, maps=plan.maps)
        free = np.arange(len(plan.entries))
        found = hausman_check(
            laid, fit_gauss_newton(laid, plan.entries, plan.start, free, progress, white)
        )
        missed = None
        if len(at) >= LEAST_FREQUENCIES:
            missed = _left_out(laid, plan, found, at, place, white)
        ways[plan.name] = Way(plan, found, missed)
    outcome = ByFrequency(experiment, entries, problem, at, place, ways, choose(ways), {})
    return outcome._replace(advice=_advice(outcome, coarse))


def check_labels(each: Sequence[str], entries: Sequence[Parameter]) -> None:
    """Raises `InputError` for a label of `each` that is not identified."""
    known = [p.label for p in entries]
    for label in each:
        if label not in known:
            near = did_you_mean(label, known)
            raise InputError(f"--each {label}: not identified; allowed {', '.join(known)}{near}")


def _advice(found: ByFrequency, coarse: Resolution) -> dict[int, Proposal]:
    """The trial at its own frequency that would narrow each undetermined entry most."""
    plan, best = found.ways[EACH].layout, found.ways[EACH].fit
    A = summed(best.blocks)[0] / best.inflation
    known, result = MeasuredInformation.of(found.problem, best), dict[int, Proposal]()
    for i, p in enumerate(plan.entries):
        g = int(plan.group[i])
        if g < 0 or determined(p, *confidence_interval(best, plan.entries, i)[1:]):
            continue
        if value_by_variation(best, i) is not None:  # more of the same data would not agree
            continue
        here = np.flatnonzero((plan.group < 0) | (plan.group == g))
        other = np.flatnonzero((plan.group >= 0) & (plan.group != g))
        own = plan.maps[int(np.flatnonzero(found.place == g)[0])].at(best.theta)
        candidates = feasible_trials(found.experiment, float(found.frequencies[g]))
        at_hand = known._replace(
            information=marginal_information(A, here, other), free=plan.member[here]
        )
        wanted = int(plan.member[i])
        proposals = best_trial(
            found.experiment, found.entries, own, [wanted], candidates, at_hand, coarse
        )
        if proposals:
            result[i] = proposals[wanted]
    return result


def _left_out(laid: TankProblem, plan: ParameterTies, found: Fit, at, place, white) -> np.ndarray:
    thetas: list[np.ndarray] = [found.theta] * len(place)
    for g in range(len(at)):
        x = _without(plan, found, at, g, place)
        for i in np.flatnonzero(place == g):
            thetas[i] = plan.maps[i].at(x)
    residuals = laid.residuals(laid.predict_each(thetas), white)
    squares = np.zeros(len(at))
    for (trial, _), r in residuals.items():
        square = float(r @ r)
        squares[place[trial]] += square if np.isfinite(square) else FAILED
    return squares


def _without(
    plan: ParameterTies, found: Fit, at: np.ndarray, g: int, place: np.ndarray
) -> np.ndarray:
    """The vector that all frequencies but the one at place `g` ask for."""
    others = [x for x in found.blocks if place[x.trial] != g]
    A, b = summed(others)
    index = np.flatnonzero(plan.group != g)
    x = found.theta + least_squares_step(A, b, index)
    low = np.array([p.prior.low for p in plan.entries])
    high = np.array([p.prior.high for p in plan.entries])
    x = np.clip(x, low, high)
    rest = np.arange(len(at)) != g
    for i in np.flatnonzero(plan.group == g):
        same = np.flatnonzero((plan.member == plan.member[i]) & (plan.group != g))
        x[i] = np.interp(at[g], at[rest], x[same])
    return x


def choose(ways: dict[str, Way]) -> str | None:
    """The way of fewest parameters within one standard error of the least left-out square."""
    if any(w.left_out is None for w in ways.values()):
        return None
    squares = {n: np.asarray(w.left_out) for n, w in ways.items()}
    best = min(squares, key=lambda n: float(squares[n].sum()))

    def close(name: str) -> bool:
        worse = squares[name] - squares[best]
        return float(worse.mean()) <= float(worse.std(ddof=1)) / np.sqrt(len(worse))

    order = sorted(ways, key=lambda n: len(ways[n].layout.entries))
    return next(n for n in order if n == best or close(n))


def values(way: Way, label: str) -> list[tuple[float, float, float, bool]]:
    """Value, 95 % interval, and whether it is determined, of the entries of a label, in order."""
    found = []
    for i, p in enumerate(way.layout.entries):
        if p.label == label:
            value, low, high = confidence_interval(way.fit, way.layout.entries, i)
            found.append((value, low, high, determined(p, low, high)))
    return found


_WORDS = {
    CONSTANT: "constant values of C_d and m_a",
    PAPER: "the paper's ramp between 2 and 3 Hz, with the paper's values",
    RAMP: "a ramp between 2 and 3 Hz as the paper's, with other values at its ends",
    EACH: "values of their own for every frequency",
}


def comparison_text(found: ByFrequency) -> str:
    """What the comparison says, in a sentence."""
    if found.chosen is None:
        return (
            f"Which of these explains the data best is not told by {len(found.frequencies)} "
            f"frequencies: {LEAST_FREQUENCIES} are needed, so that each can be left out. "
            "model.toml takes constant values."
        )
    rest = ", ".join(
        f"{n.replace('_', ' ')} {_mean_square(w):.3g}"
        for n, w in found.ways.items()
        if n != found.chosen
    )
    return (
        "The simplest way that predicts left-out frequencies as well as the best is "
        f"{_WORDS[found.chosen]}: mean square "
        f"over the noise {_mean_square(found.used):.3g}, against {rest}."
    )


def _mean_square(way: Way) -> float:
    """Of the white residuals of left-out frequencies."""
    assert way.left_out is not None
    return float(way.left_out.sum()) / way.fit.samples
