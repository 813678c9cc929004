"""Measures the white noise of each channel from the readings, without a model of the robot.

Differences of successive readings cancel a smooth signal. Differences of readings one stride apart
also cancel a signal that repeats in each stride. A clearly smaller estimate is preferred, because
the remaining signal can only increase an estimate.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from calibration.inference.noise import Noise, channel_noise, quantisation_step, signal_shares
from calibration.measurements.records import Record
from slider_jax.channels import CHANNELS, row_of
from slider_jax.experiment.schema import SensorsTable

TOO_SMALL, TOO_LARGE = 1.2, 0.8
"""The measured noise replaces the declared noise if their ratio is above or below these values.
With the right declared noise, the ratio was 0.97 to 1.07 in 54 of 55 channels of eleven data sets
of the independent program, and 0.87 in one channel. A ratio of 1.22 alone would raise the residual
above the noise floor."""
ORDERS = (4, 6)
"""Orders of the differences. The fourth order has less scatter. The sixth order suppresses more of
the signal of a camera with 100 frames per second."""
SMALLER = 0.9
"""Another estimate replaces that of the fourth order if their ratio is below this value. The
smallest of several estimates of the same noise would be too small."""
SIGNAL = 1.2
"""Largest estimate of a trial that is used, divided by the median over the trials."""
CLIP = 3.0
"""Differences beyond this many standard deviations are left out: they contain a switch of the drive
or an outlier."""
CLIPPED = 1.0 - 2.0 * CLIP * norm.pdf(CLIP) / (norm.cdf(CLIP) - norm.cdf(-CLIP))
"""Variance of a normal variable of unit variance within `CLIP` standard deviations."""
THINNING = 3
"""A noise below the declared noise must also appear in every third reading. A sensor with a
low-pass filter has little noise in successive differences, although it has the declared noise."""
LEAST_SHARE = 0.5
"""Smallest noise that is used, divided by the model-discretisation discrepancy. The model of the
discrepancy is not exact enough for a smaller noise, as in simulated readings without noise."""
FEWEST = 30
"""Smallest number of differences from which the noise of a trial is measured."""
HIGH_BAND, STRIDES = "successive differences", "differences between strides"
NOT_MEASURED, THINNED = "not measured", "differences of every third reading"


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
    for channel in CHANNELS:
        chosen = [r for r in records if r.has(channel)]
        if chosen:
            found[channel] = _channel_noise(sensors, channel, chosen)
    return found


def _channel_noise(sensors: SensorsTable, channel: str, records: list[Record]) -> ChannelNoise:
    """Returns the noise of one channel, which all `records` contain."""
    series = [r.values[row_of(channel)][r.there(channel)] for r in records]
    expected = float(np.median([channel_noise(sensors, channel, x).white for x in series]))
    key = CHANNELS[channel].noise
    declared = expected if key and getattr(sensors, key) > 0.0 else None
    lags = [_stride(r, channel) for r in records]
    repeated = [x[n:] - x[:-n] for x, n in zip(series, lags, strict=True) if 0 < n < len(x)]
    # The difference of two readings has twice the variance of the noise.
    estimates = [(_pooled(series, order), HIGH_BAND) for order in ORDERS]
    estimates.append((_pooled(repeated, ORDERS[0]) / math.sqrt(2.0), STRIDES))
    measured, method = estimates[0]
    for x, name in estimates[1:]:
        if x < SMALLER * measured:
            measured, method = x, name
    if not np.isfinite(measured):
        return ChannelNoise(declared, None, expected, NOT_MEASURED)
    if declared is None:
        return ChannelNoise(None, measured, expected, method)
    if measured < TOO_LARGE * declared:
        thinned = _pooled([x[::THINNING] for x in series], ORDERS[0])
        if thinned > TOO_LARGE * declared:
            return ChannelNoise(declared, measured, declared, method)
        if thinned > measured:
            measured, method = thinned, THINNED
    if TOO_LARGE * declared <= measured <= TOO_SMALL * declared:
        return ChannelNoise(declared, measured, declared, method)
    least = min(declared, _least_noise(sensors, channel, series))
    return ChannelNoise(declared, measured, max(measured, least), method)


def _least_noise(sensors: SensorsTable, channel: str, series: list[np.ndarray]) -> float:
    """Returns the smallest noise of a channel that the loop uses."""
    size = float(np.median([np.std(x) for x in series]))
    limits = [LEAST_SHARE * signal_shares(sensors, channel)[1] * size]
    if CHANNELS[channel].kind == "pressure":
        limits.append(float(np.median([quantisation_step(x) for x in series])) / math.sqrt(12.0))
    return max(limits)


def _stride(record: Record, channel: str) -> int:
    """Returns the number of readings in a stride, or 0 if the drive has no frequency."""
    t, f = record.t[record.there(channel)], record.trial.frequency
    return round(1.0 / (f * float(np.median(np.diff(t))))) if f else 0


def _pooled(series: Sequence[np.ndarray], order: int) -> float:
    """Returns the rms of `robust_noise_floor` over all trials, or inf without a long trial.

    Trials above the median by more than `SIGNAL` are omitted: they contain a part of the signal.
    """
    long = [x for x in series if len(x) - order >= FEWEST]
    if not long:
        return math.inf
    each, counts = np.array([(robust_noise_floor(x, order), len(x)) for x in long]).T
    kept = each <= SIGNAL * np.median(each)
    return float(np.sqrt(np.average(each[kept] ** 2, weights=counts[kept])))


def robust_noise_floor(values: np.ndarray, order: int) -> float:
    """Returns the standard deviation of the white noise in `values` (n,), without outliers.

    The estimate starts at the median absolute difference of the given order. It then repeats the
    root mean square of all differences within `CLIP` standard deviations. Unlike the median, the
    root mean square does not jump by whole quantisation steps.
    """
    d = np.abs(np.diff(values, order)) / math.sqrt(math.comb(2 * order, order))
    sigma = float(np.median(d)) / norm.ppf(0.75)
    for _ in range(20):
        before = sigma
        sigma = math.sqrt(float(np.mean(d[d <= CLIP * sigma] ** 2)) / CLIPPED)
        if abs(sigma - before) < 1e-3 * sigma:
            break
    return sigma
