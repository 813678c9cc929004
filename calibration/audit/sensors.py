"""Finds faults of one sensor: stuck or clipped readings, spikes, missing readings.

Equal successive readings are a fault only if the noise and the quantisation of the sensor make them
improbable. For example, a faultless sensor may repeat a quantised reading of a constant pressure.
If the measured quantity saturates but the sensor is not clipped, noise still varies the readings.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from calibration.measurements.records import Finding, masked_finding

IMPOSSIBLE = 1e-6
"""Equal successive readings are a fault if their probability in a series is below this value."""
MIN_REPEATS = 5
"""Fewer equal successive readings never count as a stuck sensor."""
SPIKE = 15.0
"""A spike differs from its neighbours by at least this many standard deviations of the noise."""
BRIDGED = 5
"""Readings between two clipped readings, at most this many samples apart, count as clipped."""
MIN_SHARE = 1.0 / 3.0
"""A channel is not used if less than this fraction of its readings is free of faults."""


class Quantisation(NamedTuple):
    """White noise and quantisation step of a series of readings, in the unit of the readings."""

    noise: float
    """Smallest plausible standard deviation of the noise."""
    step: float
    most: float = 0.0
    """Largest plausible standard deviation of the noise."""

    @property
    def repeat(self) -> float:
        """Returns the largest probability of two equal successive readings of a constant signal."""
        if self.noise <= 0.0:
            return 1.0
        return float(2.0 * ndtr(0.5 * self.step / self.noise) - 1.0)


def quantisation(values: np.ndarray, declared: float) -> Quantisation:
    """Returns noise and quantisation step of the readings `values` (n,), which contain no NaN.

    `declared` is the noise's declared standard deviation (0: not declared). To exclude motion, the
    noise is estimated where the signal varies least without being constant.
    """
    step = _step_of(values)
    apart = np.abs(np.diff(values, 4)) / math.sqrt(math.comb(8, 4))
    same = np.lib.stride_tricks.sliding_window_view(np.diff(values) == 0.0, 4).sum(axis=1)
    free = apart[same < 3]  # a stuck sensor has no noise
    measured = 0.0
    if len(free) >= 10:
        windows = np.array_split(free, max(len(free) // 40, 1))
        measured = float(np.quantile([np.median(w) for w in windows], 0.3)) / 0.6745
    measured = math.sqrt(max(measured**2 - step**2 / 12.0, 0.0))
    if measured < 1e-6 * float(np.std(values)):
        return Quantisation(0.0, step, declared)
    least = min(measured, declared) if declared > 0.0 else measured
    return Quantisation(least, step, max(measured, declared))


def _step_of(values: np.ndarray) -> float:
    """Returns the quantisation step: most differences of readings are multiples of this step."""
    steps = np.diff(np.unique(values))
    steps = steps[steps > 1e-12 * max(float(np.ptp(values)), 1e-300)]
    if not steps.size:
        return 0.0
    for share in (0.25, 0.1, 0.05):
        step = float(np.quantile(steps, share, method="lower"))
        ratio = steps / step
        if np.mean(np.abs(ratio - np.round(ratio)) < 0.1) > 0.9:
            return step
    return float(steps.min())


def stuck(values: np.ndarray, g: Quantisation) -> np.ndarray:
    """Returns a mask (n,) of the readings that repeat the previous reading of a stuck sensor."""
    n = len(values)
    edges = np.r_[0, np.flatnonzero(np.diff(values)) + 1, n]
    bad = np.zeros(n, bool)
    longest, rest = math.inf, 1e-9 * float(np.abs(values).max())
    if g.noise > 0.0 and g.repeat <= 0.9999:  # noise makes longer runs improbable
        longest = max(MIN_REPEATS, math.ceil(math.log(IMPOSSIBLE / n) / math.log(g.repeat)) + 1)
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        if abs(values[a]) < rest:  # before the drive starts, correct readings may be 0
            continue
        if b - a >= longest or (b - a >= MIN_REPEATS and _ends_with_jump(values, a, b, g)):
            bad[a + 1 : b] = True
    return bad


def _ends_with_jump(values: np.ndarray, a: int, b: int, g: Quantisation) -> bool:
    """Returns whether the signal jumps after the equal values[a:b], and varies around this run.

    While a sensor is stuck, the measured quantity continues to change. So the first correct reading
    differs from the stuck readings by more than nearby readings differ from each other.
    """
    after, before = values[b : b + 8], values[max(a - 8, 0) : a]
    if len(after) < 8 or len(before) < 8:
        return False
    jump = abs(float(values[b] - values[b - 1]))
    nearby = np.abs(np.r_[np.diff(after), np.diff(before)])
    moves = min(abs(float(after[-1] - after[0])), abs(float(before[-1] - before[0])))
    clear = 12.0 * (g.noise + g.step)
    return jump > 3.0 * float(nearby.max()) and jump > clear and moves > 0.5 * clear


def clipped(values: np.ndarray, g: Quantisation) -> np.ndarray:
    """Returns a mask (n,) of the readings at a limit of the sensor's range.

    A limit is an extreme value that occurs more often than the neighbouring values. With an
    unclipped sensor, noise would make some readings exceed this value.
    """
    bad = np.zeros(len(values), bool)
    if g.noise <= 0.0 or g.repeat > 0.9999:
        return bad
    ends = []
    for sign in (1.0, -1.0):
        y = sign * values
        top = float(y.max())
        at = y == top
        beside = np.sum((y < top) & (y > top - 1.5 * g.step))
        inside = ndtr(g.step / g.noise) - 0.5
        beyond = ndtr(-g.step / g.noise)
        pairs = int(np.sum(at[1:] & at[:-1]))
        chance = min((inside / (inside + beyond)) ** at.sum(), len(y) * g.repeat**pairs)
        if at.sum() >= MIN_REPEATS and at.sum() > beside and chance < IMPOSSIBLE:
            bad |= at
            places = np.flatnonzero(at)
            for a, b in zip(places[:-1], places[1:], strict=True):
                bad[a:b] |= b - a <= BRIDGED
            ends.append(top)
    if len(ends) == 1:  # the range of a sensor is often symmetric about zero
        bad |= np.abs(values) == ends[0]
    return bad


def spikes(values: np.ndarray, g: Quantisation) -> np.ndarray:
    """Returns a mask (n,) of the readings in spikes. A spike consists of one to three readings."""
    bad = np.zeros(len(values), bool)
    mirrored = np.pad(values, 4, "reflect")
    for width in (1, 2, 3):
        windows = np.lib.stride_tricks.sliding_window_view(mirrored, width + 8)
        beside = np.concatenate([windows[:, :4], windows[:, 4 + width :]], axis=1)
        low, high = beside.min(axis=1), beside.max(axis=1)
        margin = 3.0 * (high - low) + SPIKE * g.most + 2.0 * g.step
        block = windows[:, 4 : 4 + width]
        over = (block > (high + margin)[:, None]).all(axis=1)
        under = (block < (low - margin)[:, None]).all(axis=1)
        for i in map(int, np.flatnonzero(over | under)):
            at_end = i == 0 or i + width == len(values)
            if not at_end or _leaves_range(values, i, i + width):
                bad[i : i + width] = True
    return bad


def _leaves_range(values: np.ndarray, a: int, b: int) -> bool:
    """Returns whether values[a:b] exceed the range of all other readings by half its width.

    A spike at an end of the series must pass this test, because such a spike has neighbours on one
    side only. Without the test, the start from rest would count as a spike.
    """
    rest = np.r_[values[:a], values[b:]]
    low, high = float(rest.min()), float(rest.max())
    half = 0.5 * (high - low)
    return bool((values[a:b] > high + half).all() or (values[a:b] < low - half).all())


def check_sensor(
    trial: str,
    channel: str,
    t: np.ndarray,
    values: np.ndarray,
    declared: float,
    rows: np.ndarray | None = None,
) -> tuple[np.ndarray, list[Finding]]:
    """Returns a channel's readings (n,) with NaN for faulty readings, and findings.

    `t` (n,) are the times [s], `declared` is the noise's standard deviation (0: unknown), and
    `rows` (n,) marks the rows that the file contains (default: all).
    """
    there = np.flatnonzero(np.isfinite(values))
    if len(there) < 20:
        return values, []
    present = np.flatnonzero(np.ones(len(t), bool) if rows is None else rows)
    findings, usable = _frames(trial, channel, t[present], values[present]), values.copy()
    y, at = values[there], t[there]
    span = float(at[0]), float(at[-1])
    if np.ptp(y) == 0.0:
        if declared == 0.0 and y[0] == 0.0:
            return values, findings
        detail = f"{channel} is stuck at {y[0]:g} in the whole trial; the channel is not used"
        found = Finding(trial, "stuck", channel, *span, detail, "masked")
        return np.full_like(values, np.nan), [found]
    kept = np.ones(len(there), bool)
    g = quantisation(y, declared)
    for kind, find in (("spikes", spikes), ("clipped", clipped), ("stuck", stuck)):
        bad = np.zeros(len(there), bool)
        bad[kept] = find(y[kept], g)
        if bad.any():
            text = _description(kind, channel, y[bad])
            findings.append(masked_finding(trial, kind, channel, at, bad, text))
            kept &= ~bad
    if kept.sum() < max(MIN_SHARE * len(there), 20):
        detail = f"too few readings of {channel} are faultless; the channel is masked in this trial"
        findings.append(Finding(trial, "channel_lost", channel, *span, detail, "masked"))
        kept[:] = False
    usable[there[~kept]] = np.nan
    return usable, findings


def _description(kind: str, channel: str, values: np.ndarray) -> str:
    if kind == "spikes":
        return f"{channel} has spikes (readings far from all neighbouring readings)"
    if kind == "clipped":
        ends = sorted({float(values.min()), float(values.max())})
        return f"{channel} is clipped at {' and '.join(f'{x:.4g}' for x in ends)}"
    return f"{channel} is stuck: it repeats one reading for longer than its noise allows"


def _frames(trial: str, channel: str, t: np.ndarray, values: np.ndarray) -> list[Finding]:
    """Returns a finding on missing readings. A reading in every nth row only is no fault."""
    there = np.flatnonzero(np.isfinite(values))
    steps = np.diff(there)
    usual = int(np.median(steps))
    lost = np.flatnonzero(steps > 3 * usual)
    if not lost.size:
        return []
    a, b = float(t[there[lost[0]]]), float(t[there[lost[-1] + 1]])
    many = int(np.sum(np.round(steps[lost] / usual) - 1))
    detail = f"about {many} readings of {channel} are missing between {a:.4g} and {b:.4g} s"
    return [Finding(trial, "gap", channel, a, b, detail, "used")]
