"""One parameter of a live stream: recursive least squares with forgetting, window by window."""

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
        """The same with an independent deviation of a share of the value."""
        return ParameterEstimate(self.value, math.hypot(self.deviation, share * self.value))


@dataclass
class Recursive:
    """Least squares over windows whose weight falls by e in `memory` of them.

    A window says H (theta - theta_w) = g with the residual r and tangent J at its theta_w: g = sum
    r J/var, H = sum J^2/var. Kept are the discounted sums of H and of c = g + H theta_w, so that
    theta = sum c/sum H, and those of c^2, c H, H^2: the spread of the windows' pulls c - H theta
    about today's value gives its deviation, and residuals correlated within a window count once.
    The memory grows from two windows on, so that the first ones, linearised far from the value, are
    soon forgotten. Source: Ljung, L. (1999), System Identification, 2nd ed., ch. 11; the spread is
    the sandwich of `calibration.inference.intervals`.
    """

    value: float
    prior: float
    """Standard deviation of the value that it starts from."""
    low: float
    high: float
    memory: float

    def __post_init__(self):
        self.windows = 0
        self.H = self.prior**-2
        self.c = self.H * self.value
        self._squares = (0.0, 0.0, 0.0)
        self._informed = 0.0

    def update(self, g: float, H: float) -> None:
        """Take in a window; one without information changes nothing."""
        if not (H > 0.0 and math.isfinite(g) and math.isfinite(H)):
            return
        keep = 1.0 - 1.0 / min(2.0 + 0.5 * self.windows, self.memory)
        c = g + H * self.value
        self.windows += 1
        self.H, self.c = keep * self.H + H, keep * self.c + c
        fresh = (c * c, c * H, H * H)
        self._squares = tuple(
            keep**2 * x + y for x, y in zip(self._squares, fresh, strict=True)
        )  # fmt: skip
        self._informed = keep**2 * self._informed + H
        self.value = min(max(self.c / self.H, self.low), self.high)

    @property
    def estimate(self) -> ParameterEstimate:
        """The value now; its deviation is the pulls' spread, or that of white noise if larger."""
        if self.windows < 4:
            return ParameterEstimate(self.value, self.prior)
        cc, cH, HH = self._squares
        pulls = max(cc - 2.0 * self.value * cH + self.value**2 * HH, self._informed)
        return ParameterEstimate(self.value, min(math.sqrt(pulls) / self.H, self.prior))


def pull_of_lag(window: Window, variance: np.ndarray) -> tuple[float, float]:
    """g and H of `Recursive.update` for k, from the pressures of a window.

    Of the tangent only what a shift in time could not do as well: the set pressures change between
    two readings, and valves have dead times.
    """
    J = window.along[0, :2] * np.isfinite(window.residual[:2])
    shift = np.gradient(window.model[:2], axis=1) * np.isfinite(window.residual[:2])
    most = np.sum(shift**2, axis=1, keepdims=True)
    J = J - shift * np.sum(shift * J, axis=1, keepdims=True) / np.maximum(most, 1e-300)
    return _pull(J, window.residual[:2], variance[:2])


def pull_of_moment(window: Window, variance: np.ndarray) -> tuple[float, float]:
    """g and H of `Recursive.update` for K_Q, from thrust, recoil and tip of a window."""
    return _pull(window.along[1, 2:], window.residual[2:], variance[2:])


def _pull(J: np.ndarray, r: np.ndarray, variance: np.ndarray) -> tuple[float, float]:
    there = np.isfinite(r)
    J, r = np.where(there, J, 0.0), np.where(there, r, 0.0)
    return float(np.sum(J * r / variance[:, None])), float(np.sum(J * J / variance[:, None]))
