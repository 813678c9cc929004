"""Intervals of fitted parameters: what the noise leaves, what correct programs differ by, and what
two halves of the data disagree by."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.inference.gauss_newton import Fit, inverse
from calibration.inference.problem import AbstractProblem, summed
from calibration.model.extended import Parameter
from slider_jax.channels import BUILT_IN, CHANNELS

SYSTEMATIC = {"C_d": 0.004, "m_a": 0.010, "k": 0.0005, "K_Q": 0.0023}
"""Share by which the base model's parameters differ between two correct programs, one standard
deviation; in every interval beside what the noise leaves. The noise holds their difference too, as
if it were another in every trial; this is what all trials share of it. The root of the mean of two
squares: the rms over fits without noise to seven meshes and steps of three tanks (0.4, 0.8, 0.02
and 0.3 %), and over those to an independent program's four (0.35, 1.2, 0.07 and 0.12 %)."""
EFFECT = 0.02
"""The same of an effect's parameter."""
FORCES = tuple(name for name in BUILT_IN if CHANNELS[name].kind == "force")
FREED_TARE = 1e3
"""A tare that says nothing of the mean, times the larger of the sensor's noise and tare."""
HALVES = 2.0
"""Standard errors of their difference from which on two halves of the data disagree."""


def share_of(p: Parameter) -> float:
    """The share of an entry's value by which two correct programs differ."""
    return EFFECT if p.effect else SYSTEMATIC[p.name]


def confidence_interval(
    fit: Fit, entries: Sequence[Parameter], index: int
) -> tuple[float, float, float]:
    """Value and 95 % interval of the entry `index`, which was fitted."""
    place = int(np.flatnonzero(fit.free == index)[0])
    value, p = float(fit.theta[index]), entries[index]
    error = float(np.hypot(fit.errors[place], share_of(p) * value))
    return value, value - 1.96 * error, value + 1.96 * error


def hausman_check(problem: AbstractProblem, fit: Fit) -> Fit:
    """The fit with `apart` and `widening`: halves are the forces' means over a trial, and the rest.

    The tares are freed, and one linear step is taken. By Hausman's test the step has the variance
    by which the estimate's grows; one below a standard error of the estimate does not count. Where
    it is beyond chance, the error is widened by Birge's ratio, which is the step over its own.
    Source: Hausman, J. A. (1978), Econometrica 46, 1251-1271; Birge, R. T. (1932), Phys. Rev. 40,
    207-227.
    """
    if not any(channel in FORCES for _, channel in problem.noise):
        return fit
    noise = {
        key: x._replace(tare=FREED_TARE * max(x.white, x.tare)) if key[1] in FORCES else x
        for key, x in problem.noise.items()
    }
    loose = replace(problem, noise=noise)
    along = problem.tangents(fit.theta, np.eye(len(fit.theta))[fit.free])
    (A, b), (own_A, own_b) = (_normal(x, fit, along) for x in (loose, problem))
    if not (np.isfinite(A).all() and np.isfinite(own_A).all()):
        return fit
    step = inverse(A) @ b - inverse(own_A) @ own_b
    variance, own = (fit.inflation * np.diag(inverse(x)) for x in (A, own_A))
    more = variance - own
    beyond = (more > 0.0) & (step**2 > np.maximum(HALVES**2 * more, own))
    ratio = np.abs(step) / np.sqrt(np.where(beyond, more, 1.0))
    return fit._replace(apart=np.where(beyond, step, 0.0), widening=np.where(beyond, ratio, 1.0))


def _normal(
    problem: AbstractProblem, fit: Fit, along: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    white = problem.whiteners(fit.predicted)
    return summed(problem.blocks(problem.residuals(fit.predicted, white), along, white))


def by_variation(fit: Fit, index: int) -> float | None:
    """What the forces' variation alone asks the entry `index` to be, where that is beyond chance
    farther off than the other half of the data: then its interval is widened."""
    place = int(np.flatnonzero(fit.free == index)[0])
    apart = 0.0 if fit.apart is None else float(fit.apart[place])
    return float(fit.theta[index]) + apart if apart else None


def determined(p: Parameter, low: float, high: float) -> bool:
    """Whether an interval says anything: narrower than half of what was believed before."""
    return high - low < 0.5 * (p.prior.high - p.prior.low)


def correlations(fit: Fit) -> np.ndarray:
    """Of the fitted entries (k, k)."""
    error = np.sqrt(np.diag(fit.covariance))
    return fit.covariance / np.outer(error, error)
