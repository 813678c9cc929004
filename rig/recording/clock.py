"""Converts device times to the host's monotonic clock, which is common to all streams.

A message arrives after a delay that varies but is never negative. Plot the host time of each
arrival against the device time of its message. All points are then on or above the line of the
sending times. The estimate of this line is the line below all points with the smallest sum of
distances to the points. This line contains the edge of the points' lower convex hull that spans the
mean device time (Moon, Skelly and Towsley, "Estimation and removal of clock skew from network delay
measurements", INFOCOM 1999). The smallest delay is assumed to be 0.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from rig.errors import RigError

MAX_DRIFT = 1e-3
"""Largest accepted relative difference of the clocks' rates. A quartz's error is below 2e-4."""
PIECE = 60.0
"""Duration in which a clock's rate is assumed to be constant [s]."""
_SHORT = 10.0
"""In a record shorter than this [s], the delays vary too much for an estimate of the rate."""
_BLOCK = 0.5
"""`RunningClock` keeps one message for each interval of this duration [s]."""
MAX_MEDIAN_DELAY = 0.5
"""Largest median delay of samples [s]. A larger delay shows that the sensor's rate is wrong."""


Sink = Callable[[int, bytes], None]
"""Function that receives each piece of data: the host's time of arrival [ns], and the bytes."""


def host_ns() -> int:
    """Returns the host's time [ns], which never decreases and is common to all processes."""
    return time.monotonic_ns()


class ClockFit(NamedTuple):
    """Host time as a function of device time: linear between knots, extrapolated beyond knots."""

    device_s: np.ndarray
    """(knots,) device times [s]"""
    host_s: np.ndarray
    """(knots,) host times [s]"""
    late_median: float
    """Median delay of the arrivals relative to the fit [s]."""
    late_99: float
    """99th percentile of the delay [s]."""
    early_max: float
    """Largest time by which an arrival precedes the fit [s]; above 0 if the rate varies."""

    @property
    def rate(self) -> float:
        """Mean rate over the whole record: host seconds per device second."""
        return float((self.host_s[-1] - self.host_s[0]) / (self.device_s[-1] - self.device_s[0]))

    def to_host(self, device_s: np.ndarray | float) -> np.ndarray:
        """Returns the host times [s] of device times [s]."""
        x, (knots, host) = np.asarray(device_s, float), self[:2]
        left = np.clip(np.searchsorted(knots, x) - 1, 0, len(knots) - 2)
        slope = np.diff(host) / np.diff(knots)
        return host[left] + slope[left] * (x - knots[left])


def fit_clock(device_s: np.ndarray, host_s: np.ndarray) -> ClockFit:
    """Returns the clock fit of device times (n,) to arrival times at the host (n,), both [s].

    Records longer than `PIECE` are fitted in pieces, because a quartz drifts with temperature.
    Raises `RigError` if the shapes differ, if device time decreases (the device restarted, see
    `split_at_restarts`), or if the rates differ by `MAX_DRIFT` or more.
    """
    x, y = np.asarray(device_s, float), np.asarray(host_s, float)
    if x.ndim != 1 or x.shape != y.shape or not x.size:
        raise RigError.value("clock", f"arrays {x.shape} and {y.shape}", "two arrays (n,), n > 0")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise RigError.value("clock", "times that are not finite", "finite times only")
    if len(split_at_restarts(x)) > 1:
        at = split_at_restarts(x)[1].start
        raise RigError(
            f"clock: device time decreases from {x[at - 1]:g} s to {x[at]:g} s at sample {at}: "
            "the device restarted; fit each slice of split_at_restarts() separately"
        )
    length = x[-1] - x[0]
    if length >= _SHORT and abs(_line_below(x, y).drift) >= MAX_DRIFT:
        raise RigError(
            f"clock: device time advances by {length:g} s and host time by {y[-1] - y[0]:g} s; the "
            f"rates must agree to {1e6 * MAX_DRIFT:g} ppm; give times of the same run in seconds"
        )
    pieces = max(1, min(round(length / PIECE), x.size // 2))
    pairs = zip(np.array_split(x, pieces), np.array_split(y, pieces), strict=True)
    lines = [_line_below(*pair) for pair in pairs]
    ends = lines[0].middle - PIECE / 2, lines[-1].middle + PIECE / 2
    knots = np.array(
        [
            (ends[0], lines[0].at(ends[0])),
            *((line.middle, line.host) for line in lines),
            (ends[1], lines[-1].at(ends[1])),
        ]
    )
    knots = knots[np.unique(knots[:, 0], return_index=True)[1]]
    fit = ClockFit(knots[:, 0], knots[:, 1], 0.0, 0.0, 0.0)
    late = y - fit.to_host(x)
    median, most = np.quantile(late, (0.5, 0.99))
    return fit._replace(
        late_median=float(median), late_99=float(most), early_max=float(max(0.0, -late.min()))
    )


class RunningClock:
    """Updates a fit of the last `PIECE` seconds with each message, in bounded memory and time."""

    def __init__(self) -> None:
        self.resets = 0
        """Number of device restarts. After a restart, the fit uses only new messages."""
        self._blocks: dict[int, tuple[float, float]] = {}
        self._last = -np.inf
        self._line: _Line | None = None

    def add(self, device_s: float, host_s: float) -> None:
        """Adds a message that was sent at `device_s` and arrived at `host_s`, both [s]."""
        if device_s < self._last:
            self.resets += 1
            self._blocks.clear()
        self._last = device_s
        block = int(device_s // _BLOCK)
        best = self._blocks.get(block)
        if best is None or host_s - device_s < best[1] - best[0]:
            self._blocks[block], self._line = (device_s, host_s), None
            while (oldest := next(iter(self._blocks))) <= block - PIECE / _BLOCK:
                del self._blocks[oldest]

    def to_host(self, device_s: np.ndarray | float) -> np.ndarray:
        """Returns host times [s] of device times [s]. Raises `RigError` if `add` was not called."""
        if not self._blocks:
            raise RigError("clock: no message has arrived yet; add a pair of times first")
        if self._line is None:
            self._line = _line_below(*np.array(list(self._blocks.values())).T)
        return np.asarray(self._line.at(np.asarray(device_s, float)))


def split_at_restarts(device_s: np.ndarray) -> list[slice]:
    """Returns the slices between restarts of the device. Device time decreases at a restart."""
    restarts = np.flatnonzero(np.diff(device_s) < 0) + 1
    ends = [0, *restarts.tolist(), len(device_s)]
    return [slice(a, b) for a, b in zip(ends, ends[1:], strict=False)]


def unwrap_counter(counts: np.ndarray, modulus: int) -> np.ndarray:
    """Returns the counts (n,) of a counter that restarts from 0 at `modulus`, unwrapped (int64).

    A backward step larger than half the modulus is such a restart. A smaller backward step is
    kept: a packet arrived out of order, or the device restarted.
    """
    counts = np.asarray(counts).astype(np.int64)
    half = modulus // 2
    steps = (np.diff(counts) + half) % modulus - half
    return np.concatenate([counts[:1], counts[:1] + np.cumsum(steps)])


def host_sample_times(
    number: np.ndarray, arrived_ns: np.ndarray, rate: float, at: np.ndarray
) -> np.ndarray:
    """Returns the host times [ns] (int64) of the samples with the numbers `at`.

    `number` (n,) are the increasing numbers of the received samples, and `arrived_ns` (n,) are
    their arrival times. `rate` is the sensor's nominal sampling rate [Hz]. The actual rate may
    differ by the error of the sensor's quartz. Raises `RigError` if the samples did not arrive at
    this rate.
    """
    start = arrived_ns.min()  # subtracted, so that float64 resolves nanoseconds
    clock = fit_clock((number - number[0]) / rate, 1e-9 * (arrived_ns - start))
    if clock.late_median > MAX_MEDIAN_DELAY:
        raise RigError(
            f"force sensor: the median delay of {len(number)} samples at {rate:.5g} Hz is "
            f"{clock.late_median:.2g} s; allowed up to {MAX_MEDIAN_DELAY:g} s; set the sensor to "
            "that rate, or stop other programs if the computer is too busy"
        )
    return start + np.rint(1e9 * clock.to_host((at - number[0]) / rate)).astype(np.int64)


class _Line(NamedTuple):
    """A line of host time against device time [s]."""

    middle: float
    """Device time of the line's reference point."""
    host: float
    """Host time at `middle`."""
    drift: float
    """Slope minus 1."""

    def at(self, device_s: Any) -> Any:
        return self.host + (1.0 + self.drift) * (device_s - self.middle)


def _line_below(x: np.ndarray, y: np.ndarray) -> _Line:
    """Returns the line below all points with the highest mean and a drift of at most `MAX_DRIFT`.

    x (n,) and y (n,) are device and host times [s]. For a given drift, the highest line below the
    points touches one point. The mean of this line is a concave function of the drift. The best
    line touches two points: one before and one after the mean time. The loop searches for these
    points. In a record shorter than `_SHORT`, the best line may touch only one point, because the
    drift is limited. The drift is then 0.
    """
    middle = x.mean()
    u, v = x - middle, y - x

    def touched(drift: float) -> int:
        """Returns the index of the point that the line of this drift touches."""
        return int(np.argmin(v - drift * u))

    left, right = touched(-MAX_DRIFT), touched(MAX_DRIFT)
    if left == right and x[-1] - x[0] < _SHORT:
        drift = 0.0
    elif u[left] >= 0.0:
        drift = -MAX_DRIFT
    elif u[right] <= 0.0:
        drift, left = MAX_DRIFT, right
    else:
        while True:
            drift = float((v[right] - v[left]) / (u[right] - u[left]))
            lower = touched(drift)
            if v[lower] - drift * u[lower] >= v[left] - drift * u[left] or lower == right:
                break
            if u[lower] < 0.0:
                left = lower
            else:
                right = lower
    return _Line(float(middle), float(middle + v[left] - drift * u[left]), drift)
