"""Levenberg-Marquardt on a residual that comes with its tangents, and what it leaves uncertain."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from calibration.inference.gauss_newton import inverse
from slider_jax.errors import InputError

Linearised = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""x (k,) to the residual (n,), in standard deviations, and its derivative (n, k)."""


class Minimum(NamedTuple):
    """The least sum of squares."""

    x: np.ndarray
    residual: np.ndarray
    inverse: np.ndarray
    """Of the normal matrix (k, k): the covariance where the residual's deviations are right."""
    converged: bool


def minimise(linearised: Linearised, start: np.ndarray) -> Minimum:
    """The minimum near `start`, by MINPACK's Levenberg-Marquardt.

    Raises `InputError` where the model cannot be computed at the start.
    """
    known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = x.tobytes()
        if key not in known:
            known.clear()
            residual, slope = linearised(x)
            known[key] = (np.nan_to_num(residual, nan=1e6, posinf=1e6, neginf=-1e6), slope)
        return known[key]

    if not np.isfinite(linearised(start)[0]).all():
        raise InputError(
            "the robot of this file cannot be bent so far as its tables say; check loads, "
            "stiffness and units"
        )
    found = least_squares(
        lambda x: at(x)[0], start, lambda x: at(x)[1], method="lm", x_scale="jac", max_nfev=60
    )
    residual, slope = at(found.x)
    return Minimum(found.x, residual, inverse(slope.T @ slope), found.status > 0)


def quantile(freedom: float) -> float:
    """Of Student's distribution, for two-sided 95 %."""
    return float(student.ppf(0.975, max(freedom, 1.0)))
