"""Estimates a parameter from a live stream by recursive least squares with forgetting."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.twin.alarm import Window


class ParameterEstimate(NamedTuple):
    """A parameter and its standard deviation."""

    value: float
    deviation: float

    def with_share(self, share: float) -> "ParameterEstimate":
        """Returns the estimate with an additional independent error of `share` times the value."""
        return ParameterEstimate(self.value, math.hypot(self.deviation, share * self.value))


@dataclass
class RecursiveEstimator:
    """Least squares over windows. The weight of a window decreases to 1/e in `memory` windows.

    theta_w is the value of the parameter in a window. J are the derivatives of the readings with
    respect to the parameter; r are the residuals, with the variances var. A window gives
    g = sum(J r/var), H = sum(J^2/var) and c = g + H theta_w. The estimate is theta = sum(c)/sum(H).
    The spread of c - H theta between the windows gives the standard deviation. `memory` is two
    windows at first and then grows, because theta_w of the first windows may be far from theta.

    Source: Ljung, L. (1999), System Identification, 2nd ed., ch. 11. The standard deviation is a
    sandwich estimate, as in `calibration.inference.intervals`.
    """

    value: float
    prior: float
    """Standard deviation of the initial value."""
    low: float
    high: float
    memory: float

    def __post_init__(self):
        self.windows = 0
        self.H = self.prior**-2
        self.c = self.H * self.value
        self._squares = np.zeros(3)
        self._informed = 0.0

    def update(self, g: float, H: float) -> None:
        """Updates the value with g and H of a window, or ignores a window without information."""
        if not (H > 0.0 and math.isfinite(g) and math.isfinite(H)):
            return
        keep = 1.0 - 1.0 / min(2.0 + 0.5 * self.windows, self.memory)
        c = g + H * self.value
        self.windows += 1
        self.H, self.c = keep * self.H + H, keep * self.c + c
        fresh = np.array([c * c, c * H, H * H])
        self._squares = keep**2 * self._squares + fresh
        self._informed = keep**2 * self._informed + H
        self.value = min(max(self.c / self.H, self.low), self.high)

    @property
    def estimate(self) -> ParameterEstimate:
        """Value and standard deviation. The deviation is at least the deviation by white
        noise alone."""
        if self.windows < 4:
            return ParameterEstimate(self.value, self.prior)
        cc, cH, HH = self._squares
        pulls = max(cc - 2.0 * self.value * cH + self.value**2 * HH, self._informed)
        return ParameterEstimate(self.value, min(math.sqrt(pulls) / self.H, self.prior))


def lag_gradient(window: Window, variance: np.ndarray) -> tuple[float, float]:
    """Returns g and H for k from the pressures of a window, for `RecursiveEstimator.update`.

    Changes of the set pressure between two readings, and dead times of the valves, shift the
    pressures in time. The part of the derivative that equals a time shift is therefore removed.
    """
    m = window.pressures
    J = window.derivatives[0, :m] * np.isfinite(window.residual[:m])
    shift = np.gradient(window.model[:m], axis=1) * np.isfinite(window.residual[:m])
    total = np.sum(shift**2, axis=1, keepdims=True)
    J = J - shift * np.sum(shift * J, axis=1, keepdims=True) / np.maximum(total, 1e-300)
    return _gradient(J, window.residual[:m], variance[:m])


def moment_gradient(window: Window, variance: np.ndarray) -> tuple[float, float]:
    """Returns g and H for K_Q from thrust, recoil and tip, for `RecursiveEstimator.update`."""
    m = window.pressures
    return _gradient(window.derivatives[1, m:], window.residual[m:], variance[m:])


def _gradient(J: np.ndarray, r: np.ndarray, variance: np.ndarray) -> tuple[float, float]:
    finite = np.isfinite(r)
    J, r = np.where(finite, J, 0.0), np.where(finite, r, 0.0)
    return float(np.sum(J * r / variance[:, None])), float(np.sum(J * J / variance[:, None]))
