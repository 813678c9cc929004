"""Confidence intervals of fitted parameters.

The intervals account for:

- noise,
- the model-discretisation discrepancy, both the part that differs between trials and the part that
  repeats in all trials,
- correlation that remains in the whitened residuals,
- a difference between two estimates of a parameter, with and without the mean forces of the trials.

The comparison of two halves of the trials finds parameters that changed during the experiment.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2, norm

from calibration.inference.gauss_newton import Fit, inverse, reading_derivatives
from calibration.inference.intervals import correlation_time
from calibration.inference.measured_discrepancy import discretisation_errors, richardson_share
from calibration.inference.problem import AbstractProblem, summed
from calibration.inference.whiteness import FALSE_ALARM_P, whiteness_tests
from calibration.model.extended import Parameter

BASE_DISCREPANCY = {"C_d": 0.004, "m_a": 0.010, "k": 0.0005, "K_Q": 0.0023}
"""Relative standard deviation of fitted base parameters between two correct implementations of the
model. The noise model contains the part that differs between trials. Each value is the root mean
square of two rms deviations from fits to simulations without noise. The first deviations, 0.4, 0.8,
0.02 and 0.3 %, are from three tanks, each simulated with seven meshes and time steps. The second
deviations, 0.35, 1.2, 0.07 and 0.12 %, are from four tanks of the independent program."""
EFFECT_DISCREPANCY = 0.02
"""Relative standard deviation of an effect's parameter between two correct implementations."""
LEAST_ERROR = 1e-6
"""A channel does not shift parameters if its discretisation error is below this fraction of its
rms."""
FREED_TARE = 1e3
"""Tare of a force in Hausman's test, divided by the larger of white noise and declared tare."""
HAUSMAN_LIMIT = 2.0
"""Two estimates differ significantly if the difference exceeds this number of standard errors."""


def discretisation_share(p: Parameter) -> float:
    """Returns a parameter's relative standard deviation between two correct implementations."""
    return EFFECT_DISCREPANCY if p.effect else BASE_DISCREPANCY[p.name]


def errors_of_discretisation(fit: Fit, entries: Sequence[Parameter]) -> np.ndarray:
    """Returns the standard errors (k,) of the fitted entries by the discretisation of the model.

    These errors are the same in all trials, so more trials do not reduce them. Each is the larger
    of the `discretisation_share` of the value and the norm of `Fit.shifts`.
    """
    shares = np.array([discretisation_share(entries[i]) for i in fit.free])
    return np.maximum(shares * np.abs(fit.theta[fit.free]), np.linalg.norm(fit.shifts, axis=0))


def confidence_interval(
    fit: Fit, entries: Sequence[Parameter], index: int
) -> tuple[float, float, float]:
    """Returns the value of the fitted entry `index`, and both ends of its 95 % interval."""
    place = int(np.flatnonzero(fit.free == index)[0])
    value = float(fit.theta[index])
    error = float(np.hypot(fit.errors, errors_of_discretisation(fit, entries))[place])
    return value, value - 1.96 * error, value + 1.96 * error


def includes_null(fit: Fit, entries: Sequence[Parameter], indices: np.ndarray) -> bool:
    """Returns whether the 95 % region of the fitted entries `indices` includes all their nulls.

    The region of a single entry is its `confidence_interval`. The region of several entries is an
    ellipsoid with the standard errors of these intervals, and with the correlations of the fit and
    of `Fit.shifts`. The result is True if the covariance is not finite, or if no entry was fitted.
    """
    places = np.flatnonzero(np.isin(fit.free, indices))
    shifts = fit.shifts
    shifted = shifts.T @ shifts
    more = errors_of_discretisation(fit, entries) ** 2 - np.diag(shifted)
    covariance = (fit.widened_covariance + shifted + np.diag(more))[np.ix_(places, places)]
    if not (len(places) and np.isfinite(covariance).all()):
        return True
    distance = np.array([fit.theta[i] - entries[i].prior.null for i in fit.free[places]])
    return bool(distance @ inverse(covariance) @ distance < chi2.ppf(0.95, len(places)))


def shift_by_discrepancy(problem: AbstractProblem, fit: Fit, along: list[np.ndarray]) -> Fit:
    """Returns the fit with `discrepancy_products`, for a discrepancy that repeats in all trials.

    The noise model treats the model-discretisation discrepancy as independent between trials, so
    its influence decreases with the number of trials. An error of a mesh or of a time step is the
    same in all trials. `Fit.shifts` are the linear responses of the parameters to such an error:
    the difference between the fine and the coarse mesh, scaled to the discrepancy of each channel.
    The shifts by all channels add in quadrature. `along` are the derivatives of
    `reading_derivatives`.
    """
    A, _ = summed(fit.blocks)
    if problem.mesh_ratio <= 1.0 or not np.isfinite(A).all():
        return fit
    coarse = [x[0] for x in problem.coarse([fit.theta])]
    errors = discretisation_errors(problem, fit.predicted, coarse)
    white = problem.whiteners(fit.predicted)
    J = problem.whitened(along, white)
    change = problem.whitened(
        [(y - x)[None] for y, x in zip(fit.predicted, coarse, strict=True)], white
    )
    products = []
    for channel, error in errors.items():
        if error < LEAST_ERROR:
            continue
        response = sum(J[key] @ x[0] for key, x in change.items() if key[1] == channel)
        scale = problem.discrepancies[channel] / error * richardson_share(problem)
        products.append(scale * response)
    found = fit._replace(discrepancy_products=np.reshape(products, (len(products), len(fit.free))))
    return found if np.isfinite(found.shifts).all() else fit


def hausman_check(
    problem: AbstractProblem,
    entries: Sequence[Parameter],
    fit: Fit,
    along: list[np.ndarray] | None = None,
) -> Fit:
    """Returns the fit with `difference` and `widening` from Hausman's test.

    The test gives the forces a very large tare, so that the mean forces have no influence. One
    linear step from the fit then gives the second estimate. The variance of the step is the
    variance of the second estimate minus the variance of the first. A step below one standard error
    of the first estimate is ignored. A significant step widens the standard error by Birge's ratio:
    the step divided by the standard error of the step. `along` are the derivatives of
    `reading_derivatives` (default: computed). Source: Hausman, J. A. (1978), Econometrica 46,
    1251-1271; Birge, R. T. (1932), Phys. Rev. 40, 207-227.
    """
    forces = [c for c in problem.channels if problem.all_channels[c].kind == "force"]
    if not any(channel in forces for _, channel in problem.noise):
        return fit
    noise = {
        key: x._replace(tare=FREED_TARE * max(float(np.max(x.white)), x.tare))
        if key[1] in forces
        else x
        for key, x in problem.noise.items()
    }
    freed = replace(problem, noise=noise)
    if along is None:
        along = reading_derivatives(problem, entries, fit.theta, fit.free)
    (A, b), (own_A, own_b) = (_normal(x, fit, along) for x in (freed, problem))
    if not (np.isfinite(A).all() and np.isfinite(own_A).all()):
        return fit
    step = inverse(A) @ b - inverse(own_A) @ own_b
    variance, own = (fit.inflation * np.diag(inverse(x)) for x in (A, own_A))
    more = variance - own
    beyond = (more > 0.0) & (step**2 > np.maximum(HAUSMAN_LIMIT**2 * more, own))
    ratio = np.abs(step) / np.sqrt(np.where(beyond, more, 1.0))
    difference, widening = np.where(beyond, step, 0.0), np.where(beyond, ratio, 1.0)
    return fit._replace(difference=difference, widening=widening)


def _normal(
    problem: AbstractProblem, fit: Fit, along: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    white = problem.whiteners(fit.predicted)
    return summed(problem.blocks(problem.residuals(fit.predicted, white), along, white))


def value_by_variation(fit: Fit, index: int) -> float | None:
    """Returns the entry `index`, estimated without the mean forces of the trials.

    Returns None if `hausman_check` found no significant difference.
    """
    place = int(np.flatnonzero(fit.free == index)[0])
    difference = 0.0 if fit.difference is None else float(fit.difference[place])
    return float(fit.theta[index]) + difference if difference else None


def widen_by_correlation(problem: AbstractProblem, fit: Fit) -> Fit:
    """Returns the fit with `correlation`, the factor for correlated whitened residuals.

    If the test of Ljung and Box finds a correlation in a series, the effective number of samples of
    this series is smaller by the factor tau, `correlation_time`. If A is the information of the
    series, the variance of its score is then tau A. The covariance of all parameters is the
    sandwich estimate inverse(A) (sum of tau A) inverse(A).
    """
    residuals = problem.residuals(fit.predicted, problem.whiteners(fit.predicted))
    A, times = summed(fit.blocks)[0], _correlation_times(problem, fit, residuals)
    if not times or not np.isfinite(A).all():
        return fit
    more = np.sum([(times.get((x.trial, x.channel), 1.0) - 1.0) * x.A for x in fit.blocks], axis=0)
    root = inverse(A)
    ratio = np.diag(root @ more @ root) / np.maximum(np.diag(root), 1e-300)
    return fit._replace(correlation=np.sqrt(1.0 + ratio))


def _correlation_times(
    problem: AbstractProblem, fit: Fit, residuals: dict[tuple[int, str], np.ndarray]
) -> dict[tuple[int, str], float]:
    """Returns the factor tau of each series with a significant correlation."""
    tests = whiteness_tests(problem.records, fit.predicted, residuals, problem.discrepancies)
    significant = {(x.trial, x.channel) for x in tests if x.correlation_p < FALSE_ALARM_P}
    return {
        (i, channel): max(correlation_time(r), 1.0)
        for (i, channel), r in residuals.items()
        if (problem.records[i].trial.file, channel) in significant
    }


def correlation_factor(fit: Fit, index: int) -> float:
    """Returns the factor of `widen_by_correlation` for the entry `index`."""
    return float(np.broadcast_to(fit.correlation, fit.free.shape)[fit.free == index][0])


class Instability(NamedTuple):
    """A parameter with different values in the first and the second half of the trials."""

    name: str
    first: float
    second: float
    sigma: float
    """Difference of the two values, divided by its standard error."""


def unstable_parameters(fit: Fit, entries: Sequence[Parameter]) -> list[Instability]:
    """Returns the fitted parameters that differ significantly between two halves of the trials.

    The halves are the first and the last trials of the experiment file. One Gauss-Newton step from
    the common fit gives the values of each half. The variance of the difference is the sum of the
    variances of both halves, with the discretisation error of each half. All parameters together
    have the false-alarm probability `FALSE_ALARM_P` (Bonferroni).
    """
    trials = sorted({x.trial for x in fit.blocks})
    if len(trials) < 2:
        return []
    early = set(trials[: len(trials) // 2])
    halves = [
        summed([x for x in fit.blocks if (x.trial in early) == first]) for first in (True, False)
    ]
    if not all(np.isfinite(A).all() and np.isfinite(b).all() for A, b in halves):
        return []
    own = fit.theta[fit.free]
    values = [own + inverse(A) @ b for A, b in halves]
    more = np.square(fit.errors) / np.maximum(np.diag(fit.covariance), 1e-300)
    noise = fit.inflation * more * sum(np.diag(inverse(A)) for A, _ in halves)
    shares = np.array([discretisation_share(entries[i]) for i in fit.free])
    error = np.sqrt(noise + 2.0 * (shares * own) ** 2)
    limit = norm.isf(0.5 * FALSE_ALARM_P / len(own))
    found = []
    for place, i in enumerate(fit.free):
        first, second = (float(x[place]) for x in values)
        sigma = abs(first - second) / float(error[place])
        if sigma > limit:
            found.append(Instability(entries[i].label, first, second, sigma))
    return found


def determined(p: Parameter, low: float, high: float) -> bool:
    """Returns whether the interval `low` to `high` is narrower than half the prior range.

    For a positive shape parameter, logarithms are compared, because its range contains values of
    different orders of magnitude.
    """
    if p.is_shape and p.prior.low > 0.0:
        return low > 0.0 and (high / low) ** 2 < p.prior.high / p.prior.low
    return high - low < 0.5 * (p.prior.high - p.prior.low)


def correlations(fit: Fit) -> np.ndarray:
    """Returns the correlation matrix (k, k) of the fitted entries."""
    error = np.sqrt(np.diag(fit.covariance))
    return fit.covariance / np.outer(error, error)
