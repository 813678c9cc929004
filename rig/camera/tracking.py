"""Tracks the markers from frame to frame. The position of a lost marker is NaN."""

from collections.abc import Sequence

import numpy as np

from rig.camera.markers import Marker
from rig.errors import RigError

MASS_RATIO = (0.6, 1.6)
"""Allowed ratio of a marker's area to its first area. Otherwise, the marker counts as lost."""


def order_at_rest(found: Sequence[Marker], count: int, head: tuple[float, float]) -> np.ndarray:
    """Returns the positions (count, 2) [px] of the straight robot's markers, tip first.

    `head` [px] is a point in front of the head. Raises `RigError` unless exactly `count` markers
    are found.
    """
    if len(found) != count or count < 1:
        raise RigError.value(
            "camera: markers at rest",
            len(found),
            f"{max(count, 1)} (as many as the robot has)",
            "check light, focus, and other blue objects",
        )
    positions = np.array([marker[:2] for marker in found])
    return positions[np.argsort(-np.hypot(*(positions - head).T))]


def smallest_distance(positions: np.ndarray) -> float:
    """Returns the smallest distance [px] between two of the positions (markers, 2) [px]."""
    distances = np.hypot(*(positions[:, None] - positions).T)
    np.fill_diagonal(distances, np.inf)
    return float(distances.min())


class Tracker:
    """Follows markers from their first positions `start` (markers, 2) [px].

    `gate` [px] is the largest motion of a marker between frames. The gate must be below half the
    smallest distance between two markers. A found marker matches a followed marker if each is the
    nearest to the other, within the gate. A lost marker's gate grows up to the smallest distance.
    """

    def __init__(self, start: np.ndarray, gate: float):
        self._last = np.array(start, float)
        self._gate, self._widest = gate, smallest_distance(self._last)
        if not 0 < gate < self._widest / 2:
            raise RigError.value(
                "camera: gate",
                f"{gate:g} px",
                f"above 0 and below {self._widest / 2:.3g} px, half the smallest marker distance",
                "use a higher frame rate or fewer markers",
            )
        self._unseen = np.zeros(len(self._last))
        self._mass = np.full(len(self._last), np.nan)

    def follow(self, found: Sequence[Marker], passed: int = 1) -> np.ndarray:
        """Returns x [px], y [px] and quality (markers, 3); NaN, NaN, 0 for a lost marker.

        `passed` is the number of frames since the previous call.
        """
        self._unseen += passed
        points = np.tile([np.nan, np.nan, 0.0], (len(self._last), 1))
        if not found:
            return points
        positions = np.array([marker[:2] for marker in found])
        distances = np.hypot(*np.moveaxis(self._last[:, None] - positions, -1, 0))
        nearest = distances.argmin(axis=1)
        for i, j in enumerate(nearest):
            reach = min(self._gate * self._unseen[i], self._widest)
            if distances[i, j] > reach or distances[:, j].argmin() != i:
                continue
            if np.isnan(self._mass[i]):
                self._mass[i] = found[j].mass
            if MASS_RATIO[0] <= found[j].mass / self._mass[i] <= MASS_RATIO[1]:
                points[i] = *positions[j], found[j].quality
        seen = ~np.isnan(points[:, 0])
        self._last[seen], self._unseen[seen] = points[seen, :2], 0
        return points
