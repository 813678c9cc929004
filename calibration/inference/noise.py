"""Noise model of a channel, and the whitening of residuals.

A sensor's noise has three parts: white noise (with quantisation), slow noise with the correlation
time `slow_time`, and a tare that is constant in a trial. Two further parts are proportional to the
signal: a gain that differs between trials, and the model-discretisation discrepancy. The experiment
file declares the sizes of these two parts, or the constants of `slider_jax.channels` apply. The
loop replaces the constant discrepancies by measured discrepancies (`measured_discrepancy`).
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, eigh, solve_triangular, toeplitz

from calibration.inference.intervals import noise_floor
from calibration.measurements.records import declared_noise
from slider_jax.channels import Channel
from slider_jax.experiment.sensor_tables import SensorsTable

DISCREPANCY_TIME = 0.02
"""Correlation time of the model-discretisation discrepancy within a stride [s]. It depends on the
beam, not on the drive."""
DISCREPANCY_STRIDES = 10.0
"""Minimum number of strides in which the discrepancy's correlation decreases to 1/e. The measured
correlation of successive strides is 0.86 to 0.94. A mean over strides therefore hardly reduces the
discrepancy."""
DISCREPANCY_SHARE = 0.5
"""Minimum fraction of a trial in which the discrepancy's correlation decreases to 1/e. In trials of
60 to 120 s, 96 to 100 % of the discrepancy's power repeats in each stride until the end. With 0.5,
a mean over the trial keeps three quarters of the discrepancy's standard deviation, and trials of up
to 20 strides keep `DISCREPANCY_STRIDES`."""
WHOLE = 1000
"""A series with at most this number of samples is whitened as one block, with the exact covariance.
A larger block needs more time and memory than a filter with many states. With 2500 samples, a block
takes 0.33 s and 50 MB, and the filter takes 0.01 to 0.23 s."""
BLOCK = 256
"""Number of samples that are whitened together. With 768 samples, the loop on eight trials of 22 s
took no less time, and 0.4 GB more memory."""
MAX_HARMONICS = 128
"""Largest number of the drive's harmonics in the state that links the blocks."""
LINK_LIMIT = 0.3
"""The filter carries a harmonic from block to block only if a ratio exceeds this limit. The ratio
is the harmonic's variance, times the number of samples in `discrepancy_memory`, divided by
the variance of the white noise."""
PHASES = 2**14
"""Number of phases at which the discrepancy's correlation is evaluated for its harmonics."""
TIME_TOLERANCE = 0.01 * DISCREPANCY_TIME
"""Blocks share matrices if their sample times differ by less than this [s]. Correlations then
change by at most 1 %."""
EVEN_TOLERANCE = 1e-3 * DISCREPANCY_TIME
"""Sample times count as evenly spaced if each differs from even spacing by less than this [s]. The
covariance is then computed from one row."""
SCALE_STEP = 0.01
"""The discrepancy's standard deviation is rounded to values whose ratio is 1 + `SCALE_STEP`. Its
own error is about ten times as large."""
SETTLED = 1e-9
"""The covariance of the state counts as constant if its change is below this fraction of the prior
covariance."""
ALIKE = 1e-3
"""Blocks share a gain if the Frobenius norm of the change of their readings' covariance is below
this limit. The covariance is whitened by `_Block.root`. In 120 s, the information of a periodic
signal changes by less than 0.4 %. In 600 s (500 Hz, drive of 1.9 Hz), a pressure needs 83 gains
instead of 1172."""


class Noise(NamedTuple):
    """Standard deviations of one channel's noise, in the unit of the channel; `slow_time` in s.

    Gain and discrepancy are fractions of the signal.
    """

    white: float | np.ndarray
    """One value, or one value per reading (n,)."""
    slow: float = 0.0
    slow_time: float = 0.1
    tare: float = 0.0
    gain: float = 0.0
    """Standard deviation of a trial's gain, as a fraction of the reading."""
    discrepancy: float = 0.0
    """Model-discretisation discrepancy, as a fraction of the channel's rms."""
    mean_square: float = 1.0
    """Expected mean square of the whitened noise; below 1 for noise with heavy tails."""


def channel_noise(sensors: SensorsTable, channel: Channel, values: np.ndarray) -> Noise:
    """Returns the noise that an experiment declares for a channel.

    If the experiment declares no white noise, the white noise is estimated from the measured
    `values` (n,). The declared white noise of a pressure is increased by the quantisation noise.
    """
    kind, white = channel.kind, declared_noise(sensors, channel)
    there = values[np.isfinite(values)]
    if white == 0.0:
        white = max(noise_floor(there), 1e-9 * max(float(np.ptp(there)), 1e-12))
    elif kind == "pressure":
        white = float(np.hypot(white, quantisation_step(there) / np.sqrt(12.0)))
    gain, discrepancy = signal_shares(sensors, channel)
    noise = Noise(white, tare=channel.tare, gain=gain, discrepancy=discrepancy)
    if kind == "camera":
        # A robot that still swings at the start is not at rest, so the tip's tare has an error.
        return noise._replace(tare=float(np.hypot(channel.tare, sensors.start_swing)))
    if kind == "force":
        return noise._replace(
            slow=sensors.force_slow_noise,
            slow_time=sensors.force_slow_time,
            tare=float(np.hypot(channel.tare, sensors.force_tare)),
        )
    return noise


def declared_shares(sensors: SensorsTable, channel: Channel) -> tuple[float | None, float | None]:
    """Returns the gain and the discrepancy that an experiment declares for a channel, or None."""
    key = channel.share_key
    if not key:
        return None, None
    return getattr(sensors, f"{key}_gain"), getattr(sensors, f"{key}_discrepancy")


def signal_shares(sensors: SensorsTable, channel: Channel) -> tuple[float, float]:
    """Returns a channel's gain and discrepancy: the declared values, or else the constants."""
    constants = channel.gain, channel.discrepancy
    gain, discrepancy = (
        constant if declared is None else declared
        for declared, constant in zip(declared_shares(sensors, channel), constants, strict=True)
    )
    return gain, discrepancy


def quantisation_step(values: np.ndarray) -> float:
    """Returns the quantisation step of `values`, or 0 if the differences have no common divisor."""
    steps = np.diff(np.unique(values))
    steps = steps[steps > 1e-12 * max(float(np.ptp(values)), 1e-300)]
    if not steps.size:
        return 0.0
    least = float(np.median(steps[steps < 1.5 * steps.min()]))
    off = np.abs(steps / least - np.round(steps / least))
    return least if np.mean(off < 0.05) > 0.95 else 0.0


def _block_length(n: int) -> int:
    """Returns the number of samples in a block of a series with `n` samples."""
    return max(n, 1) if n <= WHOLE else BLOCK


class StationaryWhitener:
    """Whitens white noise, slow noise and discrepancy, with the covariance S.

    `t` (n,) [s] are the sample times, and `scale` is the standard deviation of the discrepancy. If
    `frequency` [Hz] is given, the model-discretisation discrepancy is correlated between strides.

    A Kalman filter whitens the series by blocks of samples. The covariance within a block is exact,
    and the state `_Modes` links the blocks. Time is proportional to n. So is the memory, apart from
    the gains, whose number grows with the logarithm of the duration. Source: Solin, A. and Särkkä,
    S. (2014), PMLR 33, 904-912, for the state of a periodic correlation.
    """

    def __init__(self, t: np.ndarray, noise: Noise, scale: float, frequency: float | None):
        variance = np.broadcast_to(np.square(noise.white), t.shape)
        # Without white noise, rounding errors could make the covariance of a block indefinite.
        self._white = np.maximum(variance, 1e-12 * (noise.slow**2 + scale**2))
        self._t, self._noise, self._scale, self._frequency = t, noise, scale, frequency
        self._modes = _Modes.of(t, noise, scale, frequency, float(np.median(self._white)))
        self._edges = [*range(0, len(t), _block_length(len(t))), len(t)]
        numbers = range(len(self._edges) - 1)
        repeated = (i for i in numbers[:-1] if _same(self._pattern(i), self._pattern(i + 1)))
        self._regular = self._matrices(self._pattern(next(repeated, 0)))
        self._gains = self._filter()

    def serves(self, t: np.ndarray, noise: Noise, scale: float, frequency: float | None) -> bool:
        """Returns whether a new whitener with these arguments would be equal."""
        own = self._noise
        return (
            (scale, frequency, noise.slow, noise.slow_time)
            == (self._scale, self._frequency, own.slow, own.slow_time)
            and np.array_equal(noise.white, own.white)
            and np.array_equal(t, self._t)
        )

    def _pattern(self, number: int) -> "_Pattern":
        """Returns the sample times and noise of a block."""
        first, last = self._edges[number : number + 2]
        lag = self._t[first:last] - self._t[first]
        # The state after the last block is not used, so any length of this block is correct.
        span = self._t[last] - self._t[first] if last < len(self._t) else np.nan
        return _Pattern(lag, span, self._white[first:last])

    def _block(self, number: int) -> "_Block":
        """Returns a block's matrices. Blocks with the same sample times and noise share them."""
        pattern = self._pattern(number)
        if _same(self._regular.pattern, pattern):
            return self._regular.cut(len(pattern.lag))
        return self._matrices(pattern)

    def _matrices(self, pattern: "_Pattern") -> "_Block":
        """Returns the matrices of a block with the given sample times and noise."""
        lag, span = pattern.lag, pattern.lag[-1] if np.isnan(pattern.span) else pattern.span
        even = np.linspace(0.0, lag[-1], len(lag))
        if np.abs(lag - even).max() < EVEN_TOLERANCE:
            cov = toeplitz(self._covariance(even))
        else:
            cov = self._covariance(np.abs(lag[:, None] - lag[None]))
        cov[np.diag_indices_from(cov)] += pattern.white
        seen, turn = self._modes.columns(lag), self._modes.turn(span)
        cov -= seen @ seen.T
        # The transpose of the symmetric matrix has LAPACK's order, so that no copy is made.
        root = cholesky(cov.T, lower=True, overwrite_a=True, check_finite=False)
        link = self._modes.columns(lag - span) - seen @ turn.T
        seen, link = (solve_triangular(root, x, lower=True) for x in (seen, link))
        return _Block(pattern, root, seen, link, turn)

    def _covariance(self, gap: np.ndarray) -> np.ndarray:
        """Returns the covariance of two readings at times that differ by `gap` [s]."""
        slow = self._noise.slow**2 * np.exp(-gap / self._noise.slow_time)
        memory = discrepancy_memory(self._t, self._frequency)
        return slow + self._scale**2 * discrepancy_correlation(gap, self._frequency, memory)

    def _filter(self) -> list["_Gain"]:
        """Returns the gain of every block by the recursion of the state's covariance."""
        state = np.eye(len(self._modes.rate))
        gains: list[_Gain] = []
        settled = None
        shared: tuple[_Gain, np.ndarray] | None = None
        for number in range(len(self._edges) - 1):
            b = self._block(number)
            if settled is not None and b is self._regular:
                gains.append(settled)
                continue
            information = b.seen.T @ b.seen
            own = _Gain.of(state, information)
            if b is not self._regular:
                gains.append(own)
            else:
                if shared is None or _change_of_readings(state - shared[1], information) >= ALIKE:
                    shared = own, state
                gains.append(shared[0])
            after = own.covariance(b)
            change = float(np.abs(after - state).max())
            settled = gains[-1] if b is self._regular and change < SETTLED else None
            state = after
        return gains

    def __call__(self, series: np.ndarray) -> np.ndarray:
        """Returns the whitened series (k, n) of `series` (k, n). NaN and inf raise no error."""
        white = np.empty(series.shape)
        state = np.zeros((len(self._modes.rate), len(series)))
        for number, gain in enumerate(self._gains):
            b, here = self._block(number), slice(*self._edges[number : number + 2])
            new = solve_triangular(b.root, series[:, here].T, lower=True, check_finite=False)
            new -= b.seen @ state
            along = gain.basis.T @ (b.seen.T @ new)
            white[:, here] = (new - b.seen @ (gain.basis @ (gain.shrink * along))).T
            step = gain.basis @ (gain.keep * along)
            state = b.turn @ (state + step) + b.link.T @ (new - b.seen @ step)
        return white


class Whitener:
    """Transforms series of one trial and channel to independent samples of unit variance.

    `t` (n,) [s] are the sample times. `model` (n,) are the predicted readings, which scale the
    parts of the noise that are proportional to the signal. If `frequency` [Hz] is given, the
    model-discretisation discrepancy is correlated between strides. Tare, gain and `spans` (k, n)
    are marginalised. Each span is a series that is multiplied by an unknown random factor of unit
    variance. `stationary` is a whitener for the other parts of the noise (default: a new one).

    The covariance is S + U^T U. The rows of U are tare, gain and spans. S is the covariance of
    white noise, slow noise and discrepancy. The result of `StationaryWhitener` is multiplied by
    (I + V^T V)^(-1/2), and the rows of V are the whitened rows of U.
    """

    def __init__(
        self,
        t: np.ndarray,
        noise: Noise,
        model: np.ndarray,
        frequency: float | None = None,
        spans: np.ndarray | None = None,
        stationary: StationaryWhitener | None = None,
    ):
        if stationary is None:
            scale = discrepancy_scale(noise, model)
            stationary = StationaryWhitener(t, noise, scale, frequency)
        self._stationary = stationary
        unknown = [noise.tare * np.ones_like(t), noise.gain * model]
        rows = np.stack(unknown if spans is None else [*unknown, *spans])
        _, size, self._low = np.linalg.svd(stationary(rows), full_matrices=False)
        self._shrink = 1.0 / np.sqrt(1.0 + size**2) - 1.0

    def __call__(self, series: np.ndarray) -> np.ndarray:
        """Returns the whitened series (k, n) of `series` (k, n). NaN and inf raise no error."""
        white = self._stationary(np.atleast_2d(series))
        along = (white @ self._low.T) * self._shrink
        for first in range(0, white.shape[1], BLOCK):
            here = slice(first, first + BLOCK)
            white[:, here] += along @ self._low[:, here]
        return white


def discrepancy_scale(noise: Noise, model: np.ndarray) -> float:
    """Returns the discrepancy's standard deviation for the predicted readings `model` (n,).

    The value is rounded, so that predictions that differ little share a `StationaryWhitener`.
    """
    scale = noise.discrepancy * (float(np.std(model)) if len(model) > 1 else 0.0)
    return float(np.exp(SCALE_STEP * np.round(np.log(scale) / SCALE_STEP))) if scale else 0.0


class _Modes(NamedTuple):
    """State that links the blocks of a series: random processes with exponential memory.

    The slow noise is one process. Without a frequency, the discrepancy is another. With a
    frequency, each harmonic of the drive has two processes, the amplitudes of its cosine and sine.
    All processes are independent and have unit variance at any time.
    """

    size: np.ndarray
    """Standard deviation (r,) of the noise that a process causes."""
    rate: np.ndarray
    """Rate of decay (r,) of a process's correlation [1/s]."""
    omega: np.ndarray
    """Angular frequency (r,) [rad/s]."""
    phase: np.ndarray
    """Phase (r,) [rad]: 0 for a cosine, -pi/2 for a sine."""
    order: np.ndarray
    """Order (r,) of the harmonic; -1 for the slow noise."""

    @classmethod
    def of(
        cls, t: np.ndarray, noise: Noise, scale: float, frequency: float | None, white: float
    ) -> "_Modes":
        """Returns the processes of one series with a variance `white` of the white noise."""
        slow = [[noise.slow], [1.0 / noise.slow_time], [0.0], [0.0], [-1.0]]
        if len(t) <= WHOLE:
            return cls(*np.array(slow))
        if not frequency:
            single = [[scale], [1.0 / DISCREPANCY_TIME], [0.0], [0.0], [0.0]]
            return cls(*np.hstack([slow, single]))
        phases = np.arange(PHASES) / PHASES / frequency
        share = np.fft.rfft(discrepancy_correlation(phases, frequency)).real / PHASES
        share = np.maximum(share[: MAX_HARMONICS + 1], 0.0)
        share[1:] *= 2.0
        memory = discrepancy_memory(t, frequency)
        readings = memory * len(t) / max(t[-1] - t[0], 1e-12)
        count = 1 + int(np.sum(share[1:] * scale**2 * readings > LINK_LIMIT * white))
        order = np.arange(count)
        size, omega = scale * np.sqrt(share[:count]), 2.0 * np.pi * frequency * order
        rate = np.full(count, 1.0 / memory)
        cosines = np.stack([size, rate, omega, np.zeros(count), order])
        sines = np.stack([size, rate, omega, np.full(count, -0.5 * np.pi), order])[:, 1:]
        return cls(*np.hstack([slow, cosines, sines]))

    def columns(self, offset: np.ndarray) -> np.ndarray:
        """Returns the covariance (n, r) of the state with readings `offset` (n,) [s] later."""
        decay = self.size * np.exp(-np.abs(offset)[:, None] * self.rate)
        return decay * np.cos(offset[:, None] * self.omega + self.phase)

    def turn(self, span: float) -> np.ndarray:
        """Returns the covariance (r, r) of the state `span` [s] later with the present state."""
        angle = (self.omega * span - self.phase)[:, None] + self.phase
        own = self.order[:, None] == self.order
        return np.where(own, np.exp(-self.rate * span)[:, None] * np.cos(angle), 0.0)


class _Pattern(NamedTuple):
    """Sample times and white noise of a block of m samples."""

    lag: np.ndarray
    """Times (m,) [s] after the first sample."""
    span: float
    """Time [s] from the first sample to the next block; NaN for the last block."""
    white: np.ndarray
    """Variances (m,) of the white noise."""


def _same(one: _Pattern, other: _Pattern) -> bool:
    """Returns whether `other` has the times and noise of the first samples of `one`."""
    n = len(other.lag)
    if n > len(one.lag) or not np.array_equal(other.white, one.white[:n]):
        return False
    shift = max(np.abs(other.lag - one.lag[:n]).max(), np.nan_to_num(abs(other.span - one.span)))
    return bool(shift < TIME_TOLERANCE)


class _Block(NamedTuple):
    """Matrices of a block of m samples, for a state of r processes at its first sample."""

    pattern: _Pattern
    root: np.ndarray
    """Cholesky factor (m, m) of the readings' covariance if the state is known."""
    seen: np.ndarray
    """Change (m, r) of the readings by the state, whitened by `root`."""
    link: np.ndarray
    """Covariance (m, r) of readings and next state if the state is known, whitened by `root`."""
    turn: np.ndarray
    """Change (r, r) of the next state by the state."""

    def cut(self, n: int) -> "_Block":
        """Returns the matrices of the first `n` samples."""
        if n == len(self.root):
            return self
        return self._replace(root=self.root[:n, :n], seen=self.seen[:n], link=self.link[:n])


class _Gain(NamedTuple):
    """Effect of a block's readings on the state, in a `basis` (r, r) of independent directions."""

    basis: np.ndarray
    shrink: np.ndarray
    """Fraction (r, 1) that is removed from the readings in each direction."""
    keep: np.ndarray
    """Variance (r, 1) of the state in each direction if the readings are known."""

    @classmethod
    def of(cls, state: np.ndarray, information: np.ndarray) -> "_Gain":
        """Returns the gain for a state with the covariance `state` (r, r).

        `information` (r, r) is the block's Fisher information of the state.
        """
        factor = cholesky(state, lower=True)
        values, vectors = eigh(factor.T @ information @ factor)
        size = np.sqrt(1.0 + np.maximum(values, 0.0))[:, None]
        return cls(factor @ vectors, 1.0 / (size * (1.0 + size)), 1.0 / size**2)

    def covariance(self, b: _Block) -> np.ndarray:
        """Returns the covariance (r, r) of the state at the start of the next block."""
        basis = (b.turn - b.link.T @ b.seen) @ self.basis
        fresh = np.eye(len(b.turn)) - b.turn @ b.turn.T - b.link.T @ b.link
        fresh[np.diag_indices_from(fresh)] += 1e-12
        return (basis * self.keep.T) @ basis.T + fresh


def _change_of_readings(change: np.ndarray, information: np.ndarray) -> float:
    """Returns the Frobenius norm of the change of a block's whitened covariance.

    `change` (r, r) is the change of the state's covariance. `information` (r, r) is the block's
    Fisher information of the state.
    """
    product = change @ information
    return float(np.sqrt(np.maximum(np.sum(product * product.T), 0.0)))


def discrepancy_memory(t: np.ndarray, frequency: float | None) -> float:
    """Returns the time [s] in which the correlation of strides decreases to 1/e.

    `t` (n,) [s] are the times of the readings. The time is `DISCREPANCY_STRIDES` strides, or the
    fraction `DISCREPANCY_SHARE` of the span of the readings if this is longer. It is infinite
    without a frequency.
    """
    if not frequency:
        return np.inf
    span = float(t[-1] - t[0]) if len(t) else 0.0
    return max(DISCREPANCY_STRIDES / frequency, DISCREPANCY_SHARE * span)


def discrepancy_correlation(
    lag: np.ndarray, frequency: float | None, memory: float = np.inf
) -> np.ndarray:
    """Returns the correlation of the model-discretisation discrepancy at a time `lag` [s].

    Within a stride, the correlation decreases exponentially with the chord between two phases on a
    circle. The correlation is high again after each stride, but lower with every further stride. It
    decreases to 1/e in the time `memory` [s]. Without a frequency, `memory` is ignored.
    """
    if not frequency:
        return np.exp(-lag / DISCREPANCY_TIME)
    chord = np.abs(np.sin(np.pi * frequency * lag)) / (np.pi * frequency)
    return np.exp(-chord / DISCREPANCY_TIME - lag / memory)
