"""Intervals of fitted parameters: what the noise leaves, and what correct programs differ by."""

from collections.abc import Sequence

import numpy as np

from calibration.fit import Fit
from calibration.plant import Parameter

SYSTEMATIC = {"C_d": 0.005, "m_a": 0.012, "k": 0.0007, "K_Q": 0.003}
"""Share by which the base model's parameters differ between two correct programs, one standard
deviation; in every interval beside what the noise leaves. The noise holds their difference too, as
if it were another in every trial; this is what all trials share of it. Measured as the rms over
fits without noise to seven meshes and steps of three tanks (0.4, 0.8, 0.02 and 0.3 %) and over
those to an independent program's four (0.35, 1.2, 0.07 and 0.12 %)."""
EFFECT = 0.02
"""The same of an effect's parameter."""


def share_of(p: Parameter) -> float:
    """The share of an entry's value by which two correct programs differ."""
    return EFFECT if p.effect else SYSTEMATIC[p.name]


def interval(fit: Fit, entries: Sequence[Parameter], index: int) -> tuple[float, float, float]:
    """Value and 95 % interval of the entry `index`, which was fitted."""
    place = int(np.flatnonzero(fit.free == index)[0])
    value, p = float(fit.theta[index]), entries[index]
    error = float(np.hypot(np.sqrt(fit.covariance[place, place]), share_of(p) * value))
    return value, value - 1.96 * error, value + 1.96 * error


def determined(p: Parameter, low: float, high: float) -> bool:
    """Whether an interval says anything: narrower than half of what was believed before."""
    return high - low < 0.5 * (p.prior.high - p.prior.low)


def correlations(fit: Fit) -> np.ndarray:
    """Of the fitted entries (k, k)."""
    error = np.sqrt(np.diag(fit.covariance))
    return fit.covariance / np.outer(error, error)
