"""Compares constant C_d and m_a with the paper's ramp and with separate values per frequency.

*Ties* are a rule for how the parameters depend on the drive frequency (`parameter_ties`). Each kind
of ties is fitted to all trials. Cross-validation then compares the kinds. For each frequency, one
linear step refits the parameters to the trials at all other frequencies. Separate values are then
interpolated to the held-out frequency. A simulation of the held-out trials with these parameters
gives the prediction error. Of all ties whose prediction error is within one standard error of the
smallest error, the comparison chooses the ties with the fewest parameters.
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
from calibration.identification.parameter_ties import (
    CONSTANT,
    EACH,
    PAPER,
    RAMP,
    RAMP_PARAMETERS,
    ParameterTies,
    constant_ties,
    drive_frequencies,
    paper_ties,
    per_frequency_ties,
    ramp_ties,
    spans_ramp,
)
from calibration.inference.gauss_newton import Fit, fit_gauss_newton, marginal_information
from calibration.inference.problem import FAILED, TankProblem, summed
from calibration.inference.uncertainty import (
    confidence_interval,
    determined,
    hausman_check,
    value_by_variation,
)
from calibration.model.extended import Parameter
from calibration.model.plan import COARSE, Resolution
from slider_jax.errors import InputError, refuse_unknown
from slider_jax.experiment.load import Experiment

MIN_FREQUENCIES = 4
"""With fewer frequencies, there is no cross-validation."""


class FittedTies(NamedTuple):
    """The fit of one kind of ties, and the result of the cross-validation."""

    ties: ParameterTies
    fit: Fit
    left_out: np.ndarray | None
    """Sum of squares (frequencies,) of the whitened residuals at each held-out frequency."""


class FrequencyComparison(NamedTuple):
    """The comparison of all kinds of ties."""

    experiment: Experiment
    entries: list[Parameter]
    """Entries of the parameter vector of one trial."""
    problem: TankProblem
    """Fitting problem with the same parameters in all trials."""
    frequencies: np.ndarray
    """Drive frequencies (frequencies,) [Hz]."""
    place: np.ndarray
    """Index (trials,) of each trial's frequency in `frequencies`."""
    fitted: dict[str, FittedTies]
    chosen: str | None
    """Name of the chosen ties, or None for fewer than `MIN_FREQUENCIES` frequencies."""
    proposals: dict[int, Proposal]
    """Proposed trial for each separate value that the data do not determine, by entry index."""

    @property
    def used(self) -> FittedTies:
        """Returns the ties that model.toml contains: the chosen ties, or else constant values."""
        return self.fitted[self.chosen or CONSTANT]


def compare_ties(
    experiment: Experiment,
    entries: list[Parameter],
    problem: TankProblem,
    initial: Fit,
    each: Sequence[str] = RAMP_PARAMETERS,
    progress: Callable[[str], None] = lambda text: None,
    coarse: Resolution = COARSE,
) -> FrequencyComparison:
    """Fits all kinds of ties and compares the fits.

    All fits start from `initial`, the fit of constant values. `each` are labels of the parameters
    that may differ between frequencies. Raises `InputError` for an unknown label, for a trial
    without a frequency, or if all trials have the same frequency.
    """
    refuse_unknown("--each", each, [p.label for p in entries])
    at, place = drive_frequencies([r.trial for r in problem.records])
    if len(at) < 2:
        raise InputError(
            f"--per-frequency: all trials are driven at {at[0]:g} Hz, but two or more frequencies "
            "are required; omit --per-frequency, or add a trial with another frequency"
        )
    white = problem.whiteners(initial.predicted)
    theta = initial.theta
    candidates = [constant_ties(entries, theta, at, place)]
    if set(RAMP_PARAMETERS) <= set(each):
        candidates.append(paper_ties(entries, theta, at, place))
        if spans_ramp(at):
            candidates.append(ramp_ties(entries, theta, at, place))
    candidates.append(per_frequency_ties(entries, theta, at, place, each))
    fitted = {}
    for ties in candidates:
        progress(f"fitting {ties.name.replace('_', ' ')} values")
        mapped = replace(problem, maps=ties.maps)
        free = np.arange(len(ties.entries))
        fit = fit_gauss_newton(mapped, ties.entries, ties.start, free, progress, white)
        fit = hausman_check(mapped, ties.entries, fit)
        squares = None
        if len(at) >= MIN_FREQUENCIES:
            squares = _left_out(mapped, ties, fit, at, place, white)
        fitted[ties.name] = FittedTies(ties, fit, squares)
    outcome = FrequencyComparison(
        experiment, entries, problem, at, place, fitted, choose_ties(fitted), {}
    )
    return outcome._replace(proposals=_proposals(outcome, coarse))


def _proposals(found: FrequencyComparison, coarse: Resolution) -> dict[int, Proposal]:
    """Returns, for each undetermined value, the trial that narrows the value's interval most."""
    ties, best = found.fitted[EACH].ties, found.fitted[EACH].fit
    A = summed(best.blocks)[0] / best.inflation
    measured, result = MeasuredInformation.of(found.problem, best), dict[int, Proposal]()
    for i, p in enumerate(ties.entries):
        g = int(ties.group[i])
        if g < 0 or determined(p, *confidence_interval(best, ties.entries, i)[1:]):
            continue
        # Fits with and without the mean forces differ, and no new trial can remove the difference.
        if value_by_variation(best, i) is not None:
            continue
        here = np.flatnonzero((ties.group < 0) | (ties.group == g))
        other = np.flatnonzero((ties.group >= 0) & (ties.group != g))
        own = ties.maps[int(np.flatnonzero(found.place == g)[0])].at(best.theta)
        candidates = feasible_trials(found.experiment, float(found.frequencies[g]))
        known = measured._replace(
            information=marginal_information(A, here, other), free=ties.parameter[here]
        )
        wanted = int(ties.parameter[i])
        proposals = best_trial(
            found.experiment, found.entries, own, [wanted], candidates, known, coarse
        )
        if proposals:
            result[i] = proposals[wanted]
    return result


def _left_out(problem: TankProblem, ties: ParameterTies, fit: Fit, at, place, white) -> np.ndarray:
    thetas: list[np.ndarray] = [fit.theta] * len(place)
    for g in range(len(at)):
        x = _without(ties, fit, at, g, place)
        for i in np.flatnonzero(place == g):
            thetas[i] = ties.maps[i].at(x)
    residuals = problem.residuals(problem.predict_each(thetas), white)
    squares = np.zeros(len(at))
    for (trial, _), r in residuals.items():
        square = float(r @ r)
        squares[place[trial]] += square if np.isfinite(square) else FAILED
    return squares


def _without(
    ties: ParameterTies, fit: Fit, at: np.ndarray, g: int, place: np.ndarray
) -> np.ndarray:
    """Returns the vector that is fitted to all trials except the trials at frequency `at[g]`."""
    others = [x for x in fit.blocks if place[x.trial] != g]
    A, b = summed(others)
    x = fit.theta + least_squares_step(A, b, np.flatnonzero(ties.group != g))
    low, high = np.array([[p.prior.low, p.prior.high] for p in ties.entries]).T
    x = np.clip(x, low, high)
    rest = np.arange(len(at)) != g
    for i in np.flatnonzero(ties.group == g):
        same = np.flatnonzero((ties.parameter == ties.parameter[i]) & (ties.group != g))
        x[i] = np.interp(at[g], at[rest], x[same])
    return x


def choose_ties(fitted: dict[str, FittedTies]) -> str | None:
    """Returns the name of the chosen ties (rule: see module), or None without cross-validation."""
    if any(x.left_out is None for x in fitted.values()):
        return None
    squares = {n: np.asarray(x.left_out) for n, x in fitted.items()}
    best = min(squares, key=lambda n: float(squares[n].sum()))

    def close(name: str) -> bool:
        worse = squares[name] - squares[best]
        return float(worse.mean()) <= float(worse.std(ddof=1)) / np.sqrt(len(worse))

    order = sorted(fitted, key=lambda n: len(fitted[n].ties.entries))
    return next(n for n in order if n == best or close(n))


def tied_values(fitted: FittedTies, label: str) -> list[tuple[float, float, float, bool]]:
    """Returns (value, low, high, determined) of every entry `label`, with the 95 % interval."""
    found = []
    for i, p in enumerate(fitted.ties.entries):
        if p.label == label:
            value, low, high = confidence_interval(fitted.fit, fitted.ties.entries, i)
            found.append((value, low, high, determined(p, low, high)))
    return found


_DESCRIPTIONS = {
    CONSTANT: "constant values of C_d and m_a",
    PAPER: "the paper's ramp between 2 and 3 Hz, with the paper's values",
    RAMP: "a ramp between 2 and 3 Hz, with identified values at 2 and at 3 Hz",
    EACH: "separate values for every frequency",
}


def comparison_text(found: FrequencyComparison) -> str:
    """Returns the result of the comparison in two sentences."""
    if found.chosen is None:
        return (
            f"The comparison needs {MIN_FREQUENCIES} frequencies for cross-validation; these data "
            f"have only {len(found.frequencies)}. model.toml contains constant values."
        )
    rest = ", ".join(
        f"{n.replace('_', ' ')} {_mean_square(x):.3g}"
        for n, x in found.fitted.items()
        if n != found.chosen
    )
    return (
        "The simplest description that predicts held-out frequencies as accurately as the best one "
        f"is {_DESCRIPTIONS[found.chosen]}. The residual's mean square in units of the noise is "
        f"{_mean_square(found.used):.3g} (other descriptions: {rest})."
    )


def _mean_square(fitted: FittedTies) -> float:
    """Returns the mean square of the whitened residuals of held-out frequencies."""
    assert fitted.left_out is not None
    return float(fitted.left_out.sum()) / fitted.fit.samples
