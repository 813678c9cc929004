"""Measures the white noise of each channel from the readings, without a model of the robot.

Differences of successive readings cancel a smooth signal. Differences of readings one stride apart
also cancel a signal that repeats in each stride. The smallest of these estimates is the measured
noise, because what remains of the signal can only increase an estimate.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from calibration.inference.noise import Noise, channel_noise, quantisation_step
from calibration.measurements.records import Record
from slider_jax.channels import CHANNELS, row_of
from slider_jax.experiment.schema import SensorsTable

TOLERANCE = 1.25
"""The measured noise replaces the declared noise if their ratio exceeds this value or is below its
inverse. With the right declared noise, the ratio was 0.97 to 1.06 in 40 channels of eight data sets
of the independent program."""
ORDERS = (4, 6)
"""Orders of the differences. The fourth order has less scatter. The sixth order suppresses more of
the signal of a camera with 100 frames per second."""
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
    methods = {
        HIGH_BAND: [[(x, order) for x in series] for order in ORDERS],
        STRIDES: [
            [
                (x[n:] - x[:-n], ORDERS[0])
                for x, n in zip(series, lags, strict=True)
                if 0 < n < len(x)
            ]
        ],
    }
    estimates = [(_pooled(x), name) for name, group in methods.items() for x in group]
    # The difference of two readings has twice the variance of the noise.
    estimates = [(x / math.sqrt(2.0) if n == STRIDES else x, n) for x, n in estimates]
    measured, method = min(estimates)
    if not np.isfinite(measured):
        return ChannelNoise(declared, None, expected, NOT_MEASURED)
    if declared is None:
        return ChannelNoise(None, measured, expected, method)
    if measured * TOLERANCE < declared:
        thinned = _pooled([(x[::THINNING], ORDERS[0]) for x in series])
        if thinned * TOLERANCE > declared:
            return ChannelNoise(declared, measured, declared, method)
        if thinned > measured:
            measured, method = thinned, THINNED
    if declared / TOLERANCE <= measured <= declared * TOLERANCE:
        return ChannelNoise(declared, measured, declared, method)
    least = min(declared, _least_noise(channel, series))
    return ChannelNoise(declared, measured, max(measured, least), method)


def _least_noise(channel: str, series: list[np.ndarray]) -> float:
    """Returns the smallest noise of a channel that the loop uses."""
    size = float(np.median([np.std(x) for x in series]))
    limits = [LEAST_SHARE * CHANNELS[channel].discrepancy * size]
    if CHANNELS[channel].kind == "pressure":
        limits.append(float(np.median([quantisation_step(x) for x in series])) / math.sqrt(12.0))
    return max(limits)


def _stride(record: Record, channel: str) -> int:
    """Returns the number of readings in a stride, or 0 if the drive has no frequency."""
    t, f = record.t[record.there(channel)], record.trial.frequency
    return round(1.0 / (f * float(np.median(np.diff(t))))) if f else 0


def _pooled(series: Sequence[tuple[np.ndarray, int]]) -> float:
    """Returns the median over trials of `robust_noise_floor`, or inf without a long trial."""
    found = [robust_noise_floor(x, order) for x, order in series if len(x) - order >= FEWEST]
    return float(np.median(found)) if found else math.inf


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
