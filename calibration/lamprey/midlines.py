"""Reads and checks the measured midlines and widths of a swimming animal from CSV files.

`lampreydata.csv` has the columns t [s], frame, point (1: head), mxmm and mymm [mm]. A point that is
not visible has blank cells. `fishwidth.csv` has s (0: snout, 1: tail) and widths in body lengths.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.measurements.records import true_runs
from slider_jax.errors import InputError
from slider_jax.io.csv import read_table

LENGTH_RANGE = (0.02, 3.0)
"""Allowed body length [m]. A length outside this range indicates a wrong unit in the file."""
MAX_STRETCH = 0.10
"""Largest allowed relative deviation of a midline's length from the median length."""
MAX_HEAD_STEP = 0.25
"""Largest allowed displacement of the head between two frames, in body lengths."""
MIN_FRAMES, MIN_POINTS = 20, 8


@dataclass(frozen=True)
class Midlines:
    """Midlines of consecutive frames in which all points are visible."""

    t: np.ndarray
    """Evenly spaced times (frames,) [s]."""
    points: np.ndarray
    """Positions x and y (frames, points, 2) [m], from head to tail."""
    incomplete_frames: int
    """Number of frames in the file that the analysis omits."""

    @property
    def lengths(self) -> np.ndarray:
        """Length of each frame's midline, (frames,) [m]."""
        return np.hypot(*np.moveaxis(np.diff(self.points, axis=1), 2, 0)).sum(axis=1)

    @property
    def interval(self) -> float:
        """Time between two frames [s]."""
        return float(self.t[1] - self.t[0])


def read_midlines(path: Path) -> Midlines:
    """Returns the longest run of frames without a blank cell in a file of midlines.

    Raises `InputError` for a wrong table, uneven times, a wrong unit, or points from tail to head.
    """
    table = read_table(path, ("t", "frame", "point", "mxmm", "mymm"), blank=("mxmm", "mymm"))
    frame, point = table["frame"], table["point"]
    numbers, index = np.unique(frame, return_inverse=True)
    count = int(point.max())
    if len(frame) != len(numbers) * count or not np.array_equal(
        point.reshape(len(numbers), -1), np.tile(np.arange(1.0, count + 1.0), (len(numbers), 1))
    ):
        raise InputError(
            f"{path}: {len(frame)} rows in {len(numbers)} frames; every frame must have one row "
            f"for each of the points 1 to {count}, in this order; sort or complete the rows"
        )
    if count < MIN_POINTS:
        raise InputError.value(f"{path}, column point", count, f"at least {MIN_POINTS} per frame")
    points = 1e-3 * np.stack([table["mxmm"], table["mymm"]], axis=1).reshape(-1, count, 2)
    t = table["t"].reshape(-1, count)
    if np.ptp(t, axis=1).max() > 0.0 or np.any(np.diff(t[:, 0]) <= 0.0):
        raise InputError(
            f"{path}, column t: all rows of a frame must have the same time, and the time must "
            "increase from frame to frame; sort the rows by frame and point"
        )
    runs = true_runs(np.asarray(np.isfinite(points).all(axis=(1, 2))))
    first, last = max(runs, key=lambda run: run[1] - run[0], default=(0, -1))
    run = slice(first, last + 1)
    if run.stop - run.start < MIN_FRAMES:
        raise InputError(
            f"{path}: {run.stop - run.start} consecutive frames without a blank cell; at least "
            f"{MIN_FRAMES} are required; trace more frames"
        )
    midlines = Midlines(t[run, 0], points[run], len(t) - (run.stop - run.start))
    _check(path, midlines, numbers[run])
    return midlines


def _check(path: Path, midlines: Midlines, frames: np.ndarray) -> None:
    steps = np.diff(midlines.t)
    if np.ptp(steps) > 0.01 * np.median(steps):
        late = int(frames[1 + np.argmax(np.abs(steps - np.median(steps)))])
        raise InputError(
            f"{path}, frame {late}: the time between two frames is up to {steps.max():g} s, the "
            f"median {np.median(steps):g} s; allowed: equal times; end the file before this frame"
        )
    lengths = midlines.lengths
    length = float(np.median(lengths))
    if not LENGTH_RANGE[0] <= length <= LENGTH_RANGE[1]:
        raise InputError(
            f"{path}, columns mxmm, mymm: the animal's length is {1e3 * length:g} mm; allowed "
            f"{1e3 * LENGTH_RANGE[0]:g} to {1e3 * LENGTH_RANGE[1]:g} mm; give the columns in mm"
        )
    off = np.abs(lengths / length - 1.0)
    if off.max() > MAX_STRETCH:
        raise InputError(
            f"{path}, frame {frames[np.argmax(off)]:g}: the midline is "
            f"{1e3 * lengths[np.argmax(off)]:.1f} mm long, the median length is "
            f"{1e3 * length:.1f} mm; the allowed difference is {MAX_STRETCH:.0%}, because an "
            "animal does not stretch; remove this frame, or trace the frame again"
        )
    moved = np.hypot(*np.diff(midlines.points[:, 0], axis=0).T)
    if moved.max() > MAX_HEAD_STEP * length:
        raise InputError(
            f"{path}, frame {frames[1 + np.argmax(moved)]:g}: the head moves by "
            f"{1e3 * moved.max():.0f} mm; allowed {1e3 * MAX_HEAD_STEP * length:.0f} mm from frame "
            "to frame; check that point 1 is the head in every frame"
        )
    travelled = midlines.points[-1].mean(axis=0) - midlines.points[0].mean(axis=0)
    ahead = np.mean(midlines.points[:, 0] - midlines.points[:, -1], axis=0)
    if travelled @ ahead <= 0.0:
        raise InputError(
            f"{path}, column point: the animal swims in the direction of the last point; point 1 "
            "must be at the head; number the points from the head to the tail"
        )


def read_width(path: Path, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns s, from 0 at the snout to 1 at the tail, and the width in body lengths.

    Raises `InputError` if s does not increase from 0 to 1, or if the widths are not plausible.
    """
    table = read_table(path, ("s", column))
    s, width = table["s"], table[column]
    if s[0] != 0.0 or s[-1] != 1.0 or np.any(np.diff(s) <= 0.0):
        raise InputError(
            f"{path}, column s: values from {s[0]:g} to {s[-1]:g}; the values must increase from 0 "
            "at the snout to 1 at the tail"
        )
    if width.min() < 0.0 or not 0.002 < width.max() < 0.3:
        raise InputError.value(
            f"{path}, column {column}",
            f"{width.min():g} to {width.max():g}",
            "widths in body lengths, with a maximum from 0.002 to 0.3",
        )
    return s, width
