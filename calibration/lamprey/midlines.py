"""Measured midlines of a swimming animal and its widths, read from CSV and checked.

`lampreydata.csv`: t [s], frame, point (1 at the head), mxmm, mymm [mm]; blank where the animal was
not seen. `fishwidth.csv`: s (0 at the snout, 1 at the tail), and widths as shares of the length.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slider_jax.errors import InputError
from slider_jax.io.csv import read_table

LENGTHS = (0.02, 3.0)
"""Lengths [m] of an animal that are believed; what lies outside is in another unit."""
STRETCH = 0.10
"""How far the length along a midline may be from its median before the frame is refused."""
JUMP = 0.25
"""How far, in lengths, the head may move between two frames."""
FEWEST_FRAMES, FEWEST_POINTS = 20, 8


@dataclass(frozen=True)
class Midlines:
    """Complete frames without a gap."""

    t: np.ndarray
    """(frames,) [s], evenly spaced."""
    points: np.ndarray
    """(frames, points, 2) [m], from head to tail."""
    left_out: int
    """Frames at the ends that were not complete."""

    @property
    def lengths(self) -> np.ndarray:
        """(frames,) [m], along the points."""
        return np.hypot(*np.moveaxis(np.diff(self.points, axis=1), 2, 0)).sum(axis=1)

    @property
    def interval(self) -> float:
        """[s] between frames."""
        return float(self.t[1] - self.t[0])


def read_midlines(path: Path) -> Midlines:
    """The longest run of complete frames in a file of midlines.

    Raises `InputError`, naming file and line or frame, on anything that is no evenly timed series
    of midlines in millimetres, head first.
    """
    table = read_table(path, ("t", "frame", "point", "mxmm", "mymm"), blank=("mxmm", "mymm"))
    frame, point = table["frame"], table["point"]
    numbers, index = np.unique(frame, return_inverse=True)
    count = int(point.max())
    if len(frame) != len(numbers) * count or not np.array_equal(
        point.reshape(len(numbers), -1), np.tile(np.arange(1.0, count + 1.0), (len(numbers), 1))
    ):
        raise InputError(
            f"{path}: {len(frame)} rows in {len(numbers)} frames; allowed every frame once, with "
            f"its points 1 to {count} in order"
        )
    if count < FEWEST_POINTS:
        raise InputError.value(f"{path}, column point", count, f"at least {FEWEST_POINTS} a frame")
    points = 1e-3 * np.stack([table["mxmm"], table["mymm"]], axis=1).reshape(-1, count, 2)
    t = table["t"].reshape(-1, count)
    if np.ptp(t, axis=1).max() > 0.0 or np.any(np.diff(t[:, 0]) <= 0.0):
        raise InputError(f"{path}, column t: time must be one in a frame and increase from frame "
                         "to frame; sort the rows by frame and point")  # fmt: skip
    run = _longest_run(np.asarray(np.isfinite(points).all(axis=(1, 2))))
    if run.stop - run.start < FEWEST_FRAMES:
        raise InputError(
            f"{path}: the longest run of complete frames has {run.stop - run.start}; at least "
            f"{FEWEST_FRAMES} are needed, without a blank between them"
        )
    found = Midlines(t[run, 0], points[run], len(t) - (run.stop - run.start))
    _check(path, found, numbers[run])
    return found


def _longest_run(complete: np.ndarray) -> slice:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], complete.astype(int), [0]])))
    begins, ends = edges[::2], edges[1::2]
    if not len(begins):
        return slice(0, 0)
    longest = int(np.argmax(ends - begins))
    return slice(int(begins[longest]), int(ends[longest]))


def _check(path: Path, found: Midlines, frames: np.ndarray) -> None:
    steps = np.diff(found.t)
    if np.ptp(steps) > 0.01 * np.median(steps):
        late = int(frames[1 + np.argmax(np.abs(steps - np.median(steps)))])
        raise InputError(
            f"{path}, frame {late}: {steps.max():g} s after another, {np.median(steps):g} s "
            "elsewhere; allowed frames at equal times; cut the file at the gap"
        )
    lengths = found.lengths
    length = float(np.median(lengths))
    if not LENGTHS[0] <= length <= LENGTHS[1]:
        raise InputError(
            f"{path}, columns mxmm, mymm: an animal of {1e3 * length:g} mm; allowed "
            f"{1e3 * LENGTHS[0]:g} to {1e3 * LENGTHS[1]:g}; are these millimetres?"
        )
    off = np.abs(lengths / length - 1.0)
    if off.max() > STRETCH:
        raise InputError(
            f"{path}, frame {frames[np.argmax(off)]:g}: {1e3 * lengths[np.argmax(off)]:.1f} mm "
            f"along the midline, {1e3 * length:.1f} mm in the median; allowed within "
            f"{STRETCH:.0%}, as an animal does not stretch; leave the frame out or trace it anew"
        )
    moved = np.hypot(*np.diff(found.points[:, 0], axis=0).T)
    if moved.max() > JUMP * length:
        raise InputError(
            f"{path}, frame {frames[1 + np.argmax(moved)]:g}: the head jumps by "
            f"{1e3 * moved.max():.0f} mm; allowed {1e3 * JUMP * length:.0f} mm between frames; "
            "is point 1 the head in every frame?"
        )
    travelled = found.points[-1].mean(axis=0) - found.points[0].mean(axis=0)
    ahead = np.mean(found.points[:, 0] - found.points[:, -1], axis=0)
    if travelled @ ahead <= 0.0:
        raise InputError(
            f"{path}, column point: the animal swims towards its last point; allowed point 1 at "
            "the head; number the points from the head"
        )


def read_width(path: Path, column: str) -> tuple[np.ndarray, np.ndarray]:
    """(s, width): s from 0 at the snout to 1 at the tail, width as a share of the length.

    Raises `InputError` on places that do not run from 0 to 1 or widths that are no such shares.
    """
    table = read_table(path, ("s", column))
    s, width = table["s"], table[column]
    if s[0] != 0.0 or s[-1] != 1.0 or np.any(np.diff(s) <= 0.0):
        raise InputError(f"{path}, column s: given {s[0]:g} to {s[-1]:g}; allowed increasing from "
                         "0 at the snout to 1 at the tail")  # fmt: skip
    if width.min() < 0.0 or not 0.002 < width.max() < 0.3:
        raise InputError.value(
            f"{path}, column {column}",
            f"{width.min():g} to {width.max():g}",
            "shares of the body length, the largest from 0.002 to 0.3",
        )
    return s, width
