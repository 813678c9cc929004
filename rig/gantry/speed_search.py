"""Searches for the swimming speed: the gantry's speed at which the robot rests in the image.

The search applies Newton's method to the drift, which is the displacement of the robot in the image
divided by the cruise time. Drift and displacement are zero at the same speed. The drift is almost
linear in the gantry's speed. The displacement is less linear, because faster runs take less time.
The slope of the drift is that of a least-squares line through the last runs. The weight of a run
depends on the noise and on the run's distance from the zero.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import inf, isfinite, nan, sqrt
from typing import NamedTuple

import numpy as np

from rig.errors import RigError

MIN_STRIDES = 2.0
"""Shortest duration of a valid run's track without a gap, in strides."""
FITTED_SPEEDS = 4
"""The slope is fitted to the runs at this number of most recent speeds."""
CURVATURE = 0.1
"""Assumed error of the line at a run, as a fraction of the distance between run and zero."""
FREE_SLOPE = (-1.0, 0.5)
"""Prior of the drift's slope: mean (for a robot without tether forces) and standard deviation."""
FLATTEST = -0.2
"""Upper bound of the drift's slope, which limits the change of speed if noise hides the slope."""
STUDENT = (1.96, 12.7, 4.3, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26)
"""Half widths of Student's 95 % interval, in standard deviations. Element i is for i repeats.
Element 0 is for a known standard deviation, and for more than nine repeats."""


class GantryPass(NamedTuple):
    """One run of the gantry at a constant speed."""

    displacement_m: float
    """Displacement of the robot relative to the camera [m], positive ahead; NaN: marker lost."""
    cruise_time_s: float
    """Time in which the displacement was measured [s]."""
    frames: int
    lost: int
    """Number of frames without the marker."""


class StopReason(Enum):
    """Reason for the end of a search."""

    CONVERGED = "the predicted change of speed is within the tolerance"
    NOISE = "the displacement is within the repeated runs' noise, and this noise is above tolerance"
    LOST = "the camera lost the marker twice at one speed; check the light, or change the speed"
    LIMIT = (
        "the displacement has no zero within the limits of speed; "
        "check whether the tether tows the robot, and the camera's direction"
    )
    BUDGET = "the search has used all its runs"


@dataclass(frozen=True)
class SpeedSearchResult:
    """Result of a search.

    | field | unit | meaning |
    |---|---|---|
    | `speed` | m/s | zero of the fitted drift; NaN if no run showed the marker |
    | `uncertainty` | m/s | half width of the 95 % interval, for the larger of noise and tolerance |
    | `noise` | m | standard deviation of repeated displacements; 0 without repeats |
    | `history` | | speed [m/s] and run (None: marker lost), in the order of the runs |
    """

    speed: float
    uncertainty: float
    noise: float
    history: tuple[tuple[float, GantryPass | None], ...]
    stopped: StopReason

    @property
    def settled(self) -> bool:
        """Whether `speed` is the swimming speed within the tolerance or the noise."""
        return self.stopped in (StopReason.CONVERGED, StopReason.NOISE)


def find_swimming_speed(
    measure: Callable[[float], GantryPass | None],
    first: float,
    limits: tuple[float, float],
    tolerance_px: float,
    scale: float,
    budget: int = 12,
    second: float | None = None,
) -> SpeedSearchResult:
    """Searches for the speed at which the displacement during the cruise is zero.

    `measure` makes a run at a speed [m/s] and returns None, or a NaN displacement, if the marker
    was lost. `first` and `second` are the first two speeds [m/s]. The default of `second` assumes a
    robot without tether forces. `limits` are the lowest and highest speed [m/s]. `budget` is the
    largest number of runs. `tolerance_px` [px] is the largest accepted displacement and must not be
    below the camera's noise: two runs cannot detect a noise slightly above the tolerance.
    `scale` [m/px] converts pixels to metres.

    The run at the result's speed is repeated once, and twice if noise ends the search. To measure
    the noise, a run is also repeated if a Newton step does not halve the displacement.
    """
    _check(first, limits, tolerance_px, scale, budget, second)
    low, high = limits
    tolerance = tolerance_px * scale
    history: list[tuple[float, GantryPass | None]] = []
    runs: list[tuple[float, GantryPass]] = []

    def outcome(why: StopReason) -> SpeedSearchResult:
        if not runs:
            return SpeedSearchResult(nan, inf, 0.0, tuple(history), why)
        noise, repeats = _noise(runs)
        zero, deviation = _line(runs, max(noise, tolerance))
        known = noise <= tolerance or repeats >= len(STUDENT)
        half_width = STUDENT[0 if known else repeats] * deviation
        return SpeedSearchResult(zero, half_width, noise, tuple(history), why)

    speed, before, newton = first, inf, False
    while len(history) < budget:
        run = measure(speed)
        if run is None or not isfinite(run.displacement_m):
            history.append((speed, None))
            if history[-2:-1] == [(speed, None)]:
                return outcome(StopReason.LOST)
            continue
        history.append((speed, run))
        runs.append((speed, run))

        here = [r.displacement_m for v, r in runs if v == speed]
        off = abs(sum(here) / len(here))
        noise, repeats = _noise(runs)
        zero = _line(runs, max(noise, tolerance))[0]
        near, quiet = abs(zero - speed) * run.cruise_time_s <= tolerance, off <= noise
        if near and len(here) > 1 and noise <= tolerance:
            return outcome(StopReason.CONVERGED)
        if (near or quiet) and len(here) > 2:
            return outcome(StopReason.NOISE)
        stuck = newton and len(here) == 1 and repeats < 3 and off > 0.5 * before
        if near or quiet or stuck:
            continue
        target = second if second is not None and len(here) == len(runs) else zero
        target = _within_bracket(target, runs, 2.0 * max(noise, tolerance))
        target = min(max(target, low), high)
        if target in limits and any(v == target for v, _ in runs):
            return outcome(StopReason.LIMIT)
        speed, before = target, off
        newton = target == zero and len(here) < len(runs)
    return outcome(StopReason.BUDGET)


def _check(first, limits, tolerance_px, scale, budget, second) -> None:
    low, high = limits
    if not 0.0 < low < high < inf:
        raise RigError.value("limits of speed", f"{low} to {high} m/s", "0 < lowest < highest")
    for name, speed in (("first", first), ("second", second)):
        if speed is not None and not low <= speed <= high:
            raise RigError.value(f"{name} speed", f"{speed} m/s", f"{low:g} to {high:g} m/s")
    if second == first:
        raise RigError.value("second speed", f"{second} m/s", "a speed other than the first")
    for name, value in (("tolerance_px", tolerance_px), ("scale", scale)):
        if not 0.0 < value < inf:
            raise RigError.value(name, value, "a number above 0")
    if budget < 2:
        raise RigError.value("budget", budget, "at least 2 runs")


def _noise(runs: list[tuple[float, GantryPass]]) -> tuple[float, int]:
    """Returns the pooled standard deviation [m] of repeated runs, and the number of repeats."""
    groups = [[r.displacement_m for v, r in runs if v == speed] for speed in {v for v, _ in runs}]
    repeats = len(runs) - len(groups)
    squares = sum(len(group) * float(np.var(group)) for group in groups)
    return (sqrt(squares / repeats) if repeats else 0.0), repeats


def _line(runs: list[tuple[float, GantryPass]], noise: float) -> tuple[float, float]:
    """Returns the zero [m/s] of the fitted drift and its standard deviation [m/s].

    `FREE_SLOPE` is a prior of the slope, because runs at one speed or at close speeds do not
    determine the slope.
    """
    last = list(dict.fromkeys(v for v, _ in reversed(runs)))[:FITTED_SPEEDS]
    v = np.array([speed for speed, _ in runs if speed in last])
    displacement, time = np.array([run[:2] for speed, run in runs if speed in last]).T
    drift = displacement / time
    nearest = v[np.abs(displacement).argmin()]
    far = np.maximum(np.abs(displacement), np.abs(v - nearest) * time)
    weight = time**2 / (noise**2 + (CURVATURE * far) ** 2)
    total = weight.sum()
    v_mean, drift_mean = weight @ v / total, weight @ drift / total
    prior = FREE_SLOPE[1] ** -2
    spread = weight @ (v - v_mean) ** 2 + prior
    slope = (weight @ ((v - v_mean) * (drift - drift_mean)) + prior * FREE_SLOPE[0]) / spread
    slope = min(slope, FLATTEST)
    zero = v_mean - drift_mean / slope
    variance = (1.0 / total + (zero - v_mean) ** 2 / spread) / slope**2
    misfit = weight @ (drift - drift_mean - slope * (v - v_mean)) ** 2 / max(len(v) - 1, 1)
    variance *= max(misfit, 1.0)
    return float(zero), float(sqrt(variance))


def _within_bracket(target: float, runs: list[tuple[float, GantryPass]], clear: float) -> float:
    """Returns `target` [m/s], or the middle of the bracket if `target` is outside the bracket.

    The bracket begins at the highest speed at which the robot overtook the gantry by more than
    `clear` [m]. It ends at the lowest speed at which the robot fell behind by more than `clear`.
    """
    slower = max((v for v, run in runs if run.displacement_m > clear), default=-inf)
    faster = min((v for v, run in runs if run.displacement_m < -clear), default=inf)
    if slower < faster and not slower < target < faster and isfinite(slower + faster):
        return 0.5 * (slower + faster)
    return target


def fit_drift(t, x, start: float, end: float, stride: float) -> GantryPass | None:
    """Returns the run with the marker at x [m] ahead of the camera at times t [s] (frames,).

    Only frames from `start` to `end` [s] are used. The track ends if the marker is lost for half a
    `stride` [s], because a robot much faster or slower than the gantry leaves the image. A straight
    line and the first two harmonics of the stride are fitted. The drift is the slope of this line.
    Returns None for a track shorter than `MIN_STRIDES`.
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
    if span < MIN_STRIDES * stride or len(t) < 12:
        return None
    phase = 2.0 * np.pi * t / stride
    ripple = [f(n * phase) for n in (1, 2) for f in (np.cos, np.sin)]
    columns = np.stack([t - t.mean(), np.ones_like(t), *ripple], axis=1)
    slope = float(np.linalg.lstsq(columns, x, rcond=None)[0][0])
    return GantryPass(slope * span, span, frames, lost)
