"""Defines maps of the speed against the tail's length and a second variable, and their maxima.

Speeds [m/s] are positive if the head leads. NaN means that no steady speed was found.
"""

from typing import NamedTuple

import numpy as np

BEST_PHASE, TOLERANCE = 0.15, 0.05
"""The paper's best phase of short tails, and the allowed difference from this phase. Both are
fractions of a period."""
MARKED = (0.0, 0.2, 0.5)
"""Marked phases, as fractions of a period: no delay, and the two that the paper compares."""
MARKED_LENGTH = 0.06
"""Length of the tail [m] at the three points `MARKED`."""


class Map(NamedTuple):
    """Speed against the tail's length and a second variable."""

    lengths: np.ndarray
    """Increasing lengths of the tail (n,) [m]."""
    across: np.ndarray
    """Increasing second variable (m,): the tail's EI [N m^2], or the phase of the rear chamber."""
    speed: np.ndarray
    """Steady speed (n, m) [m/s]."""

    def at(self, value: float) -> np.ndarray:
        """Returns the speeds (n,) where `across` is nearest to `value`."""
        return self.speed[:, int(np.argmin(np.abs(self.across - value)))]

    def slice_at(self, length: float) -> "Map":
        """Returns the map at the length that is nearest to `length` [m]."""
        i = int(np.argmin(np.abs(self.lengths - length)))
        return Map(self.lengths[i : i + 1], self.across, self.speed[i : i + 1])


class Peak(NamedTuple):
    """Maximum of a curve: `y` is the largest value, and `x` is its position."""

    x: float
    y: float
    inside: bool | None
    """Whether the curve decreases on both sides; None if a neighbouring point is missing."""


def curve_maximum(x: np.ndarray, y: np.ndarray) -> Peak:
    """Returns the maximum of the parabola through a curve's best point and its two neighbours."""
    if not np.isfinite(y).any():
        return Peak(np.nan, np.nan, None)
    i = int(np.nanargmax(y))
    best = Peak(float(x[i]), float(y[i]), False)
    if i in (0, len(y) - 1):
        return best
    if np.isnan(y[i - 1 : i + 2]).any():
        return best._replace(inside=None)
    a, b, c = np.polyfit(x[i - 1 : i + 2] - x[i], y[i - 1 : i + 2], 2)
    if not a < 0.0:  # all three values are equal
        return best
    return Peak(float(x[i] - 0.5 * b / a), float(c - 0.25 * b**2 / a), True)


def best_stiffness(over_stiffness: Map) -> list[Peak]:
    """Returns the EI [N m^2] of the largest speed at each length, by a parabola in log(EI)."""
    found = [curve_maximum(np.log(over_stiffness.across), row) for row in over_stiffness.speed]
    return [p._replace(x=float(np.exp(p.x))) for p in found]


def best_phase(over_phase: Map) -> list[Peak]:
    """Returns the phase with the largest speed at each length."""
    return [curve_maximum(over_phase.across, row) for row in over_phase.speed]
