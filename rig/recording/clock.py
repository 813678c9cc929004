"""One clock for all streams: the host's monotonic one, and devices' clocks laid against it.

What a device sends arrives late, by a time that jitters but is never negative: arrivals lie above
the line that is the device's clock. It is found as the highest line below all of them, by the sum
of distances: the edge of their lower convex hull that spans their mean device time (Moon, Skelly
and Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999).
The least delay of all cannot be known, and counts as none.
"""

import time
from typing import Any, NamedTuple

import numpy as np

from rig.errors import RigError

MAX_DRIFT = 1e-3
"""Rates of two sound clocks differ by less; a quartz keeps 2e-4."""
PIECE = 60.0
"""Over so long a rate counts as constant [s]."""
_SHORT = 10.0
"""Over less than this jitter hides a rate [s]."""
_BLOCK = 0.5
"""The on-line fit keeps one arrival of each such stretch [s]."""

LATEST = 0.5
"""Samples of which half came later than this [s] were not taken at the rate that is claimed."""


def host_ns() -> int:
    """The host's clock [ns]: never set back, and the same in all processes of the machine."""
    return time.monotonic_ns()


class ClockFit(NamedTuple):
    """The host's time against the device's: straight between knots, and beyond them."""

    device_s: np.ndarray
    """(knots,) device times [s]"""
    host_s: np.ndarray
    """(knots,) host times [s]"""
    late_median: float
    """Half of the arrivals were later than this, by the fit [s]."""
    late_99: float
    """One arrival in a hundred was later than this [s]."""
    early_most: float
    """The earliest arrival was before its time by this [s]: rates change within a piece."""

    @property
    def rate(self) -> float:
        """Host seconds a device second, over the whole record."""
        return float((self.host_s[-1] - self.host_s[0]) / (self.device_s[-1] - self.device_s[0]))

    @property
    def offset(self) -> float:
        """Host time at device time 0 [s]."""
        return float(self.to_host(0.0))

    def to_host(self, device_s: np.ndarray | float) -> np.ndarray:
        """Host times [s] of device times [s]."""
        x, (knots, host) = np.asarray(device_s, float), self[:2]
        left = np.clip(np.searchsorted(knots, x) - 1, 0, len(knots) - 2)
        slope = np.diff(host) / np.diff(knots)
        return host[left] + slope[left] * (x - knots[left])


def fit_clock(device_s: np.ndarray, host_s: np.ndarray) -> ClockFit:
    """Fit the times of a device (n,) to the times of arrival at the host (n,), both [s].

    Records longer than `PIECE` are fitted piece by piece, since a quartz changes with temperature.
    Raises `RigError` for arrays that do not match, for a device time that falls (the device
    restarted, see `segments`), and for rates that differ by `MAX_DRIFT` and more.
    """
    x, y = np.asarray(device_s, float), np.asarray(host_s, float)
    if x.ndim != 1 or x.shape != y.shape or not x.size:
        raise RigError.value("clock", f"arrays {x.shape} and {y.shape}", "two of (n,), n > 0")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise RigError.value("clock", "times that are not finite", "finite ones; leave those out")
    if len(split_at_restarts(x)) > 1:
        at = split_at_restarts(x)[1].start
        raise RigError(
            f"clock: device time falls from {x[at - 1]:g} s to {x[at]:g} s at sample {at}: "
            "the device restarted; align each of split_at_restarts() by itself"
        )
    length = x[-1] - x[0]
    if length >= _SHORT and abs(_line_below(x, y).drift) >= MAX_DRIFT:
        raise RigError(
            f"clock: {length:g} s of the device take {y[-1] - y[0]:g} s of the host; allowed "
            f"a difference of {1e6 * MAX_DRIFT:g} ppm; give both in seconds, and of one run"
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
        late_median=float(median), late_99=float(most), early_most=float(max(0.0, -late.min()))
    )


class RunningClock:
    """`align` on line, over the last `PIECE` seconds, in bounded memory and time."""

    def __init__(self) -> None:
        self.resets = 0
        """How often device time fell: the device restarted, and the fit began anew."""
        self._blocks: dict[int, tuple[float, float]] = {}
        self._last = -np.inf
        self._line: _Line | None = None

    def add(self, device_s: float, host_s: float) -> None:
        """What the device sent at `device_s` arrived at `host_s`, both [s]."""
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
        """Host times [s] of device times [s]. Raises `RigError` before the first `add`."""
        if not self._blocks:
            raise RigError("clock: nothing has arrived yet; add a pair of times first")
        if self._line is None:
            self._line = _line_below(*np.array(list(self._blocks.values())).T)
        return np.asarray(self._line.at(np.asarray(device_s, float)))


def split_at_restarts(device_s: np.ndarray) -> list[slice]:
    """The runs between restarts of the device, at which its time falls."""
    falls = np.flatnonzero(np.diff(device_s) < 0) + 1
    ends = [0, *falls.tolist(), len(device_s)]
    return [slice(a, b) for a, b in zip(ends, ends[1:], strict=False)]


def unwrap_counter(counts: np.ndarray, modulus: int) -> np.ndarray:
    """Counts (n,) of a counter that starts again from 0 at `modulus`, as ones that go on (int64).

    A step of more than half the modulus is a wrap; a smaller one backwards stays (reordered
    packets, or a restart).
    """
    counts = np.asarray(counts).astype(np.int64)
    half = modulus // 2
    steps = (np.diff(counts) + half) % modulus - half
    return np.concatenate([counts[:1], counts[:1] + np.cumsum(steps)])


def host_sample_times(
    number: np.ndarray, arrived_ns: np.ndarray, rate: float, at: np.ndarray
) -> np.ndarray:
    """Host times [ns], int64, of the samples numbered `at`.

    `number` (n,), rising, are the samples that arrived at `arrived_ns` (n,); `rate` [Hz] is the
    sensor's, right to what crystals differ. Raises `RigError` where they did not come at that rate.
    """
    start = arrived_ns.min()  # so that a double holds nanoseconds
    clock = fit_clock((number - number[0]) / rate, 1e-9 * (arrived_ns - start))
    if clock.late_median > LATEST:
        raise RigError(
            f"force sensor: half of {len(number)} samples came {clock.late_median:.2g} s late and "
            f"more, by a rate of {rate:.5g} Hz; see that the sensor is set to that rate, and that "
            "this computer is not too busy to receive them"
        )
    return start + np.rint(1e9 * clock.to_host((at - number[0]) / rate)).astype(np.int64)


class _Line(NamedTuple):
    middle: float
    host: float
    """Where the line is at `middle`."""
    drift: float
    """Its slope less 1."""

    def at(self, device_s: Any) -> Any:
        return self.host + (1.0 + self.drift) * (device_s - self.middle)


def _line_below(x: np.ndarray, y: np.ndarray) -> _Line:
    """The highest line below the points, by its mean, of drifts up to `MAX_DRIFT`.

    For a given drift it rests on one point; its mean is concave in the drift, and greatest where
    it rests on points on both sides of the mean time: those two are closed in upon. A short record
    that rests on one point at any drift tells none: 0.
    """
    middle = x.mean()
    u, v = x - middle, y - x

    def rest(drift: float) -> int:
        return int(np.argmin(v - drift * u))

    left, right = rest(-MAX_DRIFT), rest(MAX_DRIFT)
    if left == right and x[-1] - x[0] < _SHORT:
        drift = 0.0
    elif u[left] >= 0.0:
        drift = -MAX_DRIFT
    elif u[right] <= 0.0:
        drift, left = MAX_DRIFT, right
    else:
        while True:
            drift = float((v[right] - v[left]) / (u[right] - u[left]))
            lower = rest(drift)
            if v[lower] - drift * u[lower] >= v[left] - drift * u[left] or lower == right:
                break
            if u[lower] < 0.0:
                left = lower
            else:
                right = lower
    return _Line(float(middle), float(middle + v[left] - drift * u[left]), drift)
