"""How fast the robot's marker drifts through the view of the gantry's camera during a cruise."""

from typing import NamedTuple

import numpy as np

FEWEST_STRIDES = 2.0
"""Of an unbroken track, for a run to count."""


class GantryPass(NamedTuple):
    """One pass of the gantry at a constant speed."""

    displacement_m: float
    """Of the robot relative to the camera, positive where it gains on the gantry; NaN if lost."""
    cruise_time_s: float
    """Duration in which it was displaced."""
    frames: int
    lost: int
    """How many of the frames did not show the marker."""


def drift(t, x, start: float, end: float, stride: float) -> GantryPass | None:
    """The run of a track: marker at x [m] ahead of the camera at times t [s], (frames,) each.

    Only frames from `start` to `end` [s] count, and only up to where the marker is lost for half a
    `stride` [s] or longer: a robot much faster or slower than the gantry leaves the view. The drift
    is the slope of a straight line fitted together with the ripple of the stride and its second
    harmonic. None if less than `FEWEST_STRIDES` are left.
    """
    t, x = np.asarray(t, float), np.asarray(x, float)
    cruise = (t >= start) & (t <= end)
    t, x = t[cruise], x[cruise]
    frames, seen = len(t), np.isfinite(x)
    lost = int(frames - seen.sum())
    t, x = t[seen], x[seen]
    if len(t) == 0 or t[0] - start > 0.5 * stride:
        return None
    gaps = np.flatnonzero(np.diff(t) >= 0.5 * stride)
    if len(gaps):
        t, x = t[: gaps[0] + 1], x[: gaps[0] + 1]
    span = float(t[-1] - t[0])
    if span < FEWEST_STRIDES * stride or len(t) < 12:
        return None
    phase = 2.0 * np.pi * t / stride
    ripple = [f(n * phase) for n in (1, 2) for f in (np.cos, np.sin)]
    columns = np.stack([t - t.mean(), np.ones_like(t), *ripple], axis=1)
    slope = float(np.linalg.lstsq(columns, x, rcond=None)[0][0])
    return GantryPass(slope * span, span, frames, lost)
