"""Which marker is which, from frame to frame; a marker that is not seen is NaN."""

from collections.abc import Sequence

import numpy as np

from rig.camera.markers import Marker
from rig.errors import RigError

MASS = (0.6, 1.6)
"""What a marker may have of the mass it had when first seen: less is half hidden, more another."""


def order_at_rest(found: Sequence[Marker], count: int, head: tuple[float, float]) -> np.ndarray:
    """Places (count, 2) [px] of a straight robot's markers, tip first.

    `head` [px] is a point beyond the head's end. Raises `RigError` unless there are `count`.
    """
    if len(found) != count or count < 1:
        raise RigError.value(
            "camera: markers at rest",
            len(found),
            f"{max(count, 1)} (as many as the robot has)",
            "check light, focus, and what else is blue",
        )
    places = np.array([marker[:2] for marker in found])
    return places[np.argsort(-np.hypot(*(places - head).T))]


class Tracker:
    """Keeps `start` (markers, 2) [px] apart by nearest assignment.

    `gate` [px] is the farthest that a marker moves from one frame to the next, and less than half
    the least distance between two. A place is a marker's where each is the other's nearest, within
    the gate; of one that is lost the gate widens with every frame, up to that least distance.
    """

    def __init__(self, start: np.ndarray, gate: float):
        self._last = np.array(start, float)
        apart = np.hypot(*(self._last[:, None] - self._last).T)
        np.fill_diagonal(apart, np.inf)
        self._gate, self._widest = gate, apart.min()
        if not 0 < gate < self._widest / 2:
            raise RigError.value(
                "camera: gate",
                f"{gate:g} px",
                f"above 0 and below {self._widest / 2:.3g} px, half the least distance of two",
                "take more frames a second, or fewer markers",
            )
        self._unseen = np.zeros(len(self._last))
        self._mass = np.full(len(self._last), np.nan)

    def follow(self, found: Sequence[Marker], passed: int = 1) -> np.ndarray:
        """x, y [px] and quality (markers, 3) in a frame that comes `passed` frames after the last;
        NaN, NaN, 0 for a marker that is lost.
        """
        self._unseen += passed
        points = np.tile([np.nan, np.nan, 0.0], (len(self._last), 1))
        if not found:
            return points
        places = np.array([marker[:2] for marker in found])
        apart = np.hypot(*np.moveaxis(self._last[:, None] - places, -1, 0))
        nearest = apart.argmin(axis=1)
        for i, j in enumerate(nearest):
            reach = min(self._gate * self._unseen[i], self._widest)
            if apart[i, j] > reach or apart[:, j].argmin() != i:
                continue
            if np.isnan(self._mass[i]):
                self._mass[i] = found[j].mass
            if MASS[0] <= found[j].mass / self._mass[i] <= MASS[1]:
                points[i] = *places[j], found[j].quality
        seen = ~np.isnan(points[:, 0])
        self._last[seen], self._unseen[seen] = points[seen, :2], 0
        return points


def displacement(xy: np.ndarray, apart: int = 1) -> np.ndarray:
    """Mean motion [px] of the markers xy (frames, markers, 2) over `apart` frames.

    (frames - apart, 2): the robot's drift before the camera, over the markers seen in both frames;
    NaN where none is. `apart` of a whole stride takes the swimming motion out.
    """
    moved = xy[apart:] - xy[:-apart]
    seen = ~np.isnan(moved).any(axis=2)
    total = np.where(seen[..., None], moved, 0.0).sum(axis=1)
    count = seen.sum(axis=1)[:, None].astype(float)
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)
