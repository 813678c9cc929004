"""Faults of one sensor's series: stuck, clipped, spikes, frames that are missing.

A reading that repeats is a fault only where noise and quantisation make it impossible: a pressure
that has settled repeats its codes, and a signal that saturates by physics still carries its noise.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from calibration.measurements.findings import Finding, masked

IMPOSSIBLE = 1e-6
"""Probability by chance, of a whole series, below which a repetition is a fault."""
FEWEST = 5
"""Equal readings in a row that are too few to be called stuck."""
SPIKE = 15.0
"""A spike stands out by so many standard deviations of the noise."""
BRIDGED = 5
"""Readings between two clipped ones that are clipped too, or chosen by their noise."""
LEAST_LEFT = 1.0 / 3.0
"""A channel of which less is left is not used at all."""


class Grain(NamedTuple):
    """How fine a series is: white noise (one standard deviation) and quantisation step."""

    noise: float
    """The least that is plausible."""
    step: float
    most: float = 0.0
    """The most that is plausible."""

    @property
    def repeat(self) -> float:
        """Largest probability of two equal readings of a signal that rests."""
        if self.noise <= 0.0:
            return 1.0
        return float(2.0 * ndtr(0.5 * self.step / self.noise) - 1.0)


def grain(values: np.ndarray, declared: float) -> Grain:
    """The grain of readings (n,) without NaN: the smaller of declared and measured noise.

    The noise is measured where the signal is quietest, so that motion is not taken for it, but not
    where it never changes. 0 where there is none.
    """
    step = lattice(values)
    apart = np.abs(np.diff(values, 4)) / math.sqrt(math.comb(8, 4))
    same = np.lib.stride_tricks.sliding_window_view(np.diff(values) == 0.0, 4).sum(axis=1)
    free = apart[same < 3]  # where a sensor stands still it shows no noise
    measured = 0.0
    if len(free) >= 10:
        windows = np.array_split(free, max(len(free) // 40, 1))
        measured = float(np.quantile([np.median(w) for w in windows], 0.3)) / 0.6745
    measured = math.sqrt(max(measured**2 - step**2 / 12.0, 0.0))
    if measured < 1e-6 * float(np.std(values)):
        return Grain(0.0, step, declared)
    least = min(measured, declared) if declared > 0.0 else measured
    return Grain(least, step, max(measured, declared))


def lattice(values: np.ndarray) -> float:
    """The quantisation step of readings (n,): what nearly all their distances are multiples of."""
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


def stuck(values: np.ndarray, g: Grain) -> np.ndarray:
    """(n,) whether a reading is the repetition of a stuck sensor's; the first one is kept."""
    n = len(values)
    edges = np.r_[0, np.flatnonzero(np.diff(values)) + 1, n]
    bad = np.zeros(n, bool)
    longest, rest = _longest_repeat(n, g), 1e-9 * float(np.abs(values).max())
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        if abs(values[a]) < rest:  # at rest before the start, without noise
            continue
        if b - a >= longest or (b - a >= FEWEST and _jumps_out(values, a, b, g)):
            bad[a + 1 : b] = True
    return bad


def _longest_repeat(n: int, g: Grain) -> float:
    """Equal readings in a row that chance does not make of `n` readings of a signal at rest."""
    if g.noise <= 0.0 or g.repeat > 0.9999:
        return math.inf
    return max(FEWEST, math.ceil(math.log(IMPOSSIBLE / n) / math.log(g.repeat)) + 1)


def _jumps_out(values: np.ndarray, a: int, b: int, g: Grain) -> bool:
    """Whether a signal that moved before and after the run values[a:b] leaves it by a leap.

    It moved by as much as the leap while the sensor stood still: by more than anywhere nearby.
    """
    after, before = values[b : b + 8], values[max(a - 8, 0) : a]
    if len(after) < 8 or len(before) < 8:
        return False
    leap = abs(float(values[b] - values[b - 1]))
    nearby = np.abs(np.r_[np.diff(after), np.diff(before)])
    moves = min(abs(float(after[-1] - after[0])), abs(float(before[-1] - before[0])))
    grain_size = 12.0 * (g.noise + g.step)
    return leap > 3.0 * float(nearby.max()) and leap > grain_size and moves > 0.5 * grain_size


def clipped(values: np.ndarray, g: Grain) -> np.ndarray:
    """(n,) whether a reading lies on the end of the sensor's range.

    The end is a value that is read again and again, and oftener than the one next to it, while none
    lies beyond: noise would have carried some of them there.
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
        if at.sum() >= FEWEST and at.sum() > beside and chance < IMPOSSIBLE:
            bad |= _bridged(at)
            ends.append(top)
    if len(ends) == 1:  # a range that ends at one side at x may end at the other at -x
        bad |= np.abs(values) == ends[0]
    return bad


def _bridged(at: np.ndarray) -> np.ndarray:
    """`at`, with the places between two of them that are near each other."""
    places = np.flatnonzero(at)
    whole = at.copy()
    for a, b in zip(places[:-1], places[1:], strict=True):
        if b - a <= BRIDGED:
            whole[a:b] = True
    return whole


def spikes(values: np.ndarray, g: Grain) -> np.ndarray:
    """(n,) whether one to three readings in a row stand out of all their neighbours."""
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
    """Whether values[a:b] leave the range of all others by half of it.

    The first and the last reading have neighbours on one side only, and a start from rest leaps.
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
    """A channel's readings (n,) at `t` (n,) [s], faults made NaN, and findings.

    `declared` is one standard deviation of its noise, 0 where unknown; `rows` (n,) where the file
    has a row at all, by default everywhere.
    """
    there = np.flatnonzero(np.isfinite(values))
    if len(there) < 20:
        return values, []
    present = np.flatnonzero(np.ones(len(t), bool) if rows is None else rows)
    findings, mended = _frames(trial, channel, t[present], values[present]), values.copy()
    y, at = values[there], t[there]
    if np.ptp(y) == 0.0:
        if declared == 0.0 and y[0] == 0.0:
            return values, findings
        detail = f"{channel} is stuck at {y[0]:g} in the whole trial; the channel is not used"
        span = float(at[0]), float(at[-1])
        return np.full_like(values, np.nan), [
            Finding(trial, "stuck", channel, *span, detail, "masked")
        ]
    kept = np.ones(len(there), bool)
    g = grain(y, declared)
    for kind, find in (("spikes", spikes), ("clipped", clipped), ("stuck", stuck)):
        bad = np.zeros(len(there), bool)
        bad[kept] = find(y[kept], g)
        if bad.any():
            said = _said(kind, channel, y[bad], int(kept.sum()))
            findings.append(masked(trial, kind, channel, at, bad, said))
            kept &= ~bad
    if kept.sum() < max(LEAST_LEFT * len(there), 20):
        detail = f"so little of {channel} is left that the channel is not used in this trial"
        span = float(at[0]), float(at[-1])
        findings.append(Finding(trial, "channel_lost", channel, *span, detail, "masked"))
        kept[:] = False
    mended[there[~kept]] = np.nan
    return mended, findings


def _said(kind: str, channel: str, values: np.ndarray, many: int) -> str:
    if kind == "spikes":
        return f"{channel} has spikes, readings that stand out of all their neighbours"
    if kind == "clipped":
        ends = sorted({float(values.min()), float(values.max())})
        return f"{channel} is clipped at {' and '.join(f'{x:.4g}' for x in ends)}"
    return f"{channel} is stuck, it repeats one reading longer than its noise allows"


def _frames(trial: str, channel: str, t: np.ndarray, values: np.ndarray) -> list[Finding]:
    """Stretches in which a channel that has readings at a steady pace has none."""
    there = np.flatnonzero(np.isfinite(values))
    steps = np.diff(there)
    pace = int(np.median(steps))
    lost = np.flatnonzero(steps > 3 * pace)
    if not lost.size:
        return []
    a, b = float(t[there[lost[0]]]), float(t[there[lost[-1] + 1]])
    many = int(np.sum(np.round(steps[lost] / pace) - 1))
    detail = f"about {many} readings of {channel} are missing between {a:.4g} and {b:.4g} s"
    return [Finding(trial, "gap", channel, a, b, detail, "used")]
