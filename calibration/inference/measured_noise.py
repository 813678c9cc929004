"""Measures the white noise of each channel from the readings, without a model of the robot.

Differences of successive readings cancel a smooth signal. Differences of readings one stride apart
also cancel a signal that repeats in each stride. If a signal remains in the differences, it
increases the estimate. If one estimate is clearly smaller, it is therefore used.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from calibration.inference.noise import Noise, channel_noise, quantisation_step, signal_shares
from calibration.measurements.records import Record, declared_noise
from slider_jax.channels import Channel
from slider_jax.experiment.sensor_tables import SensorsTable

TOO_SMALL, TOO_LARGE = 1.15, 0.8
"""The measured noise replaces the declared noise if their ratio is above or below these values.
With the right declared noise, the ratio was 0.97 to 1.07 in 54 of 55 channels of eleven data sets
of the independent program, and 0.87 in one channel. A ratio of 1.22 alone would raise the residual
above the noise floor."""
ERRORS = 3.0
"""Two noises differ only if their difference also exceeds this many standard errors. With 70
readings in a trial, an estimate has a standard error of 14 %."""
ORDERS = (4, 6)
"""Orders of the differences. An estimate of the fourth order has less scatter than an estimate of
the sixth order. The sixth order cancels more of the signal of a camera with 100 frames/s."""
SMALLER = 0.9
"""Another estimate replaces the estimate of the fourth order if their ratio is below this value.
Without this margin, the smallest of several estimates of the same noise would be too small."""
SIGNAL = 1.2
"""A trial is omitted if its estimate exceeds the median over the trials by more than this factor.
The factor is increased by `ERRORS` standard errors."""
CLIP = 3.0
"""Differences larger than this many standard deviations are omitted, because they contain a switch
of the drive or an outlier."""
CLIPPED = 1.0 - 2.0 * CLIP * norm.pdf(CLIP) / (norm.cdf(CLIP) - norm.cdf(-CLIP))
"""Variance of a normal variable of unit variance within `CLIP` standard deviations."""
THINNING = 3
"""A noise below the declared noise must also appear in every third reading. A sensor with a
low-pass filter has little noise in successive differences, although it has the declared noise."""
LEAST_SHARE = 0.5
"""The used noise is at least this fraction of the model-discretisation discrepancy. The model of
the discrepancy is not exact enough for a smaller noise, as in simulated readings without noise."""
FEWEST = 30
"""With fewer differences, the noise of a trial is not measured."""
HIGH_BAND, STRIDES = "successive differences", "differences between strides"
NOT_MEASURED, THINNED = "not measured", "differences of every third reading"


class NoiseEstimate(NamedTuple):
    """A white noise that was measured from differences of readings."""

    size: float
    """Standard deviation of the noise; infinite if no trial has enough readings."""
    error: float
    """Standard error of the size, as a fraction of the size."""
    method: str

    def is_below(self, share: float, other: float) -> bool:
        """Returns whether the noise is below a fraction of the noise `other`."""
        return self.size < min(share, 1.0 - ERRORS * self.error) * other

    def is_above(self, factor: float, other: float) -> bool:
        """Returns whether the noise is above a multiple of the noise `other`."""
        return self.size > max(factor, 1.0 + ERRORS * self.error) * other


class ChannelNoise(NamedTuple):
    """White noise of a channel as a standard deviation, in the unit of the channel."""

    declared: float | None
    """Declared noise with the quantisation noise of a pressure. None: no noise is declared."""
    measured: float | None
    """None if no trial has enough readings."""
    used: float
    """Median over the trials if no noise is declared, because each trial then has its own noise."""
    method: str
    """Source of the measured noise."""
    freedom: float | None = None
    """Degrees of freedom of Student's t-distribution if the noise has heavy tails."""

    @property
    def replaced(self) -> bool:
        """Returns whether the measured noise is used instead of the declared noise."""
        return self.declared is not None and self.used != self.declared

    def of_trial(self, noise: Noise) -> Noise:
        """Returns the noise of one trial with the white noise that is used."""
        return noise._replace(white=self.used) if self.replaced else noise


def measured_noises(sensors: SensorsTable, records: Sequence[Record]) -> dict[str, ChannelNoise]:
    """Returns the declared, measured and used white noise of each channel in the `records`."""
    found = {}
    for name, channel in records[0].channels.items():
        chosen = [r for r in records if r.has(name)]
        if chosen:
            found[name] = _channel_noise(sensors, channel, chosen)
    return found


def _channel_noise(sensors: SensorsTable, channel: Channel, records: list[Record]) -> ChannelNoise:
    """Returns the noise of one channel, which all `records` contain."""
    series = [r.values[r.row(channel.name)][r.there(channel.name)] for r in records]
    expected = float(np.median([channel_noise(sensors, channel, x).white for x in series]))
    declared = expected if declared_noise(sensors, channel) > 0.0 else None
    lags = [_stride(r, channel.name) for r in records]
    repeated = [x[n:] - x[:-n] for x, n in zip(series, lags, strict=True) if 0 < n < len(x)]
    best, *others = [_pooled(series, order, HIGH_BAND) for order in ORDERS]
    # The difference of two readings has twice the variance of the noise.
    strides = _pooled(repeated, ORDERS[0], STRIDES)
    for x in (*others, strides._replace(size=strides.size / math.sqrt(2.0))):
        if x.is_below(SMALLER, best.size):
            best = x
    # If most differences are zero, they measure the quantisation instead of the noise.
    if not 0.0 < best.size < np.inf:
        return ChannelNoise(declared, None, expected, NOT_MEASURED)
    if declared is None:
        return ChannelNoise(None, best.size, expected, best.method)
    if best.is_below(TOO_LARGE, declared):
        thinned = _pooled([x[::THINNING] for x in series], ORDERS[0], THINNED)
        if np.isfinite(thinned.size) and not thinned.is_below(TOO_LARGE, declared):
            return ChannelNoise(declared, best.size, declared, best.method)
        if best.size < thinned.size < np.inf:
            best = thinned
    elif not best.is_above(TOO_SMALL, declared):
        return ChannelNoise(declared, best.size, declared, best.method)
    least = min(declared, _least_noise(sensors, channel, series))
    return ChannelNoise(declared, best.size, max(best.size, least), best.method)


def _least_noise(sensors: SensorsTable, channel: Channel, series: list[np.ndarray]) -> float:
    """Returns the smallest noise of a channel that the loop uses."""
    size = float(np.median([np.std(x) for x in series]))
    limits = [
        LEAST_SHARE * signal_shares(sensors, channel)[1] * size,
        float(np.median([quantisation_step(x) for x in series])) / math.sqrt(12.0),
    ]
    return max(limits)


def _stride(record: Record, channel: str) -> int:
    """Returns the number of readings in a stride, or 0 if the drive has no frequency."""
    t, f = record.t[record.there(channel)], record.trial.frequency
    return round(1.0 / (f * float(np.median(np.diff(t))))) if f else 0


def _pooled(series: Sequence[np.ndarray], order: int, method: str) -> NoiseEstimate:
    """Returns the rms of `robust_noise_floor` over all trials.

    Trials with an estimate clearly above the median are omitted, because their differences contain
    a part of the signal.
    """
    long = [x for x in series if len(x) - order >= FEWEST]
    if not long:
        return NoiseEstimate(math.inf, 0.0, method)
    sizes, counts = np.array([(robust_noise_floor(x, order), len(x)) for x in long]).T
    errors = difference_error(order) / np.sqrt(counts)
    kept = sizes <= (SIGNAL + ERRORS * errors) * np.median(sizes)
    size = float(np.sqrt(np.average(sizes[kept] ** 2, weights=counts[kept])))
    return NoiseEstimate(size, difference_error(order) / math.sqrt(counts[kept].sum()), method)


def difference_error(order: int) -> float:
    """Returns the relative standard error of a noise from n differences, times sqrt(n).

    Differences of white noise have the autocorrelation C(2m, m + k)/C(2m, m) at the lag k, for the
    order m. The mean square of n correlated normal variables has the relative variance (2/n) times
    the sum of squared autocorrelations.
    """
    rho = [math.comb(2 * order, order + k) / math.comb(2 * order, order) for k in range(order + 1)]
    return math.sqrt(0.5 * (1.0 + 2.0 * sum(x**2 for x in rho[1:])))


def robust_noise_floor(values: np.ndarray, order: int) -> float:
    """Returns the standard deviation of the white noise in `values` (n,), without outliers.

    The first estimate is the median absolute difference of the given order. Each further estimate
    is the root mean square of all differences within `CLIP` times the last estimate. Unlike the
    median, the root mean square does not jump by whole quantisation steps.
    """
    d = np.abs(np.diff(values, order)) / math.sqrt(math.comb(2 * order, order))
    sigma = float(np.median(d)) / norm.ppf(0.75)
    for _ in range(20):
        before = sigma
        sigma = math.sqrt(float(np.mean(d[d <= CLIP * sigma] ** 2)) / CLIPPED)
        if abs(sigma - before) < 1e-3 * sigma:
            break
    return sigma
