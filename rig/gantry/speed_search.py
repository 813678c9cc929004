"""The swimming speed: the gantry's speed at which the robot stands still before its camera.

Newton's method on the drift, displacement / cruise time, whose zero is the displacement's and which
is nearly straight in the gantry's speed, as the displacement is not: a faster run is shorter. Its
slope is a secant's through the last runs by least squares, each weighted by its noise and by how
far from the zero it lies.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import inf, isfinite, nan, sqrt
from typing import NamedTuple

import numpy as np

from rig.errors import RigError

FEWEST_STRIDES = 2.0
"""Of an unbroken track, for a run to count."""
LAST = 4
"""Speeds whose runs tell the slope."""
BEND = 0.1
"""Share of a run's drift to which the straight line is trusted."""
FREE = (-1.0, 0.5)
"""The slope of a robot that the gantry does not pull, and how far a tether may change it."""
FLATTEST = -0.2
"""Slope that bounds a step where the drift levels off, or grows by chance."""
STUDENT = (1.96, 12.7, 4.3, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26)
"""Half of Student's 95 % interval for a standard deviation from 1, 2, ... repeats; the first is for
a known one, and for more repeats than these."""


class GantryPass(NamedTuple):
    """One pass of the gantry at a constant speed."""

    displacement_m: float
    """Of the robot relative to the camera, positive where it gains on the gantry; NaN if lost."""
    cruise_time_s: float
    """Duration in which it was displaced."""
    frames: int
    lost: int
    """How many of the frames did not show the marker."""


class StopReason(Enum):
    """Why a search ended."""

    CONVERGED = "the predicted change of speed is within the tolerance"
    NOISE = "the displacement is within the noise of repeated runs, which exceeds the tolerance"
    LOST = "the camera lost the marker twice at one speed; see the light, or start nearer"
    LIMIT = (
        "the displacement has no zero within the limits of speed; "
        "see whether the tether tows the robot, and which way the camera looks"
    )
    BUDGET = "the runs are spent"


@dataclass(frozen=True)
class SpeedSearchResult:
    """Outcome of a search.

    | field | unit | meaning |
    |---|---|---|
    | `speed` | m/s | where the fitted drift is zero; NaN without a run that shows the marker |
    | `uncertainty` | m/s | half its 95 % interval, for noise as in `noise` or of the tolerance |
    | `noise` | m | standard deviation of repeated displacements; 0 without repeats |
    | `history` | | speed [m/s] and run, None if lost, in the order in which they were made |
    """

    speed: float
    uncertainty: float
    noise: float
    history: tuple[tuple[float, GantryPass | None], ...]
    stopped: StopReason

    @property
    def settled(self) -> bool:
        """Whether `speed` is the swimming speed, to the tolerance or as near as the noise lets."""
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
    """Search the speed at which the displacement over the cruise is zero, to a tolerance in pixels.

    Two runs alone cannot tell a noise a little above the tolerance: take none finer than the
    camera's own noise.

    `measure` makes a run at a speed [m/s]; None or a displacement of NaN says that the marker was
    lost. `first` is where to start, `second` where to go next (default: where a free swimmer would
    stand still), `limits` the lowest and highest speed [m/s], `scale` the metres of a pixel,
    `budget` the most runs, lost ones included. The speed is repeated once before it counts as
    found, and once more if the noise and not the tolerance ends the search; where a step of
    Newton's does not halve the displacement, the speed is repeated to learn the noise.
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
        wide = STUDENT[0 if known else repeats] * deviation
        return SpeedSearchResult(zero, wide, noise, tuple(history), why)

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
        raise RigError.value("second speed", f"{second} m/s", "another one than the first")
    for name, value in (("tolerance_px", tolerance_px), ("scale", scale)):
        if not 0.0 < value < inf:
            raise RigError.value(name, value, "a number above 0")
    if budget < 2:
        raise RigError.value("budget", budget, "2 runs or more")


def _noise(runs: list[tuple[float, GantryPass]]) -> tuple[float, int]:
    """Standard deviation [m] of displacements at equal speeds, pooled, and the count of repeats."""
    groups = [[r.displacement_m for v, r in runs if v == speed] for speed in {v for v, _ in runs}]
    repeats = len(runs) - len(groups)
    squares = sum(len(group) * float(np.var(group)) for group in groups)
    return (sqrt(squares / repeats) if repeats else 0.0), repeats


def _line(runs: list[tuple[float, GantryPass]], noise: float) -> tuple[float, float]:
    """Zero [m/s] of the drift, and its standard deviation [m/s].

    The slope of `FREE` counts as one more measurement, so that runs too close to each other to
    tell the slope, or at a single speed, do not leave it to the noise.
    """
    last = list(dict.fromkeys(v for v, _ in reversed(runs)))[:LAST]
    v = np.array([speed for speed, _ in runs if speed in last])
    displacement, time = np.array([run[:2] for speed, run in runs if speed in last]).T
    drift = displacement / time
    nearest = v[np.abs(displacement).argmin()]
    far = np.maximum(np.abs(displacement), np.abs(v - nearest) * time)
    weight = time**2 / (noise**2 + (BEND * far) ** 2)
    total = weight.sum()
    v_mean, drift_mean = weight @ v / total, weight @ drift / total
    prior = FREE[1] ** -2
    spread = weight @ (v - v_mean) ** 2 + prior
    slope = (weight @ ((v - v_mean) * (drift - drift_mean)) + prior * FREE[0]) / spread
    slope = min(slope, FLATTEST)
    zero = v_mean - drift_mean / slope
    variance = (1.0 / total + (zero - v_mean) ** 2 / spread) / slope**2
    misfit = weight @ (drift - drift_mean - slope * (v - v_mean)) ** 2 / max(len(v) - 1, 1)
    variance *= max(misfit, 1.0)
    return float(zero), float(sqrt(variance))


def _within_bracket(target: float, runs: list[tuple[float, GantryPass]], clear: float) -> float:
    """`target`, or the middle of the bracket if it lies outside: between the fastest run that the
    robot outpaced and the slowest that outpaced it, by more than `clear` [m]."""
    slower = max((v for v, run in runs if run.displacement_m > clear), default=-inf)
    faster = min((v for v, run in runs if run.displacement_m < -clear), default=inf)
    if slower < faster and not slower < target < faster and isfinite(slower + faster):
        return 0.5 * (slower + faster)
    return target


def fit_drift(t, x, start: float, end: float, stride: float) -> GantryPass | None:
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
