"""Noise model of a channel, and the whitening of residuals.

A sensor's noise has three parts: white noise (with quantisation), slow noise correlated over
`slow_time`, and a tare that is constant in a trial. Two further parts are proportional to the
signal: a gain that differs between trials, and the model-discretisation discrepancy.
`slider_jax.channels` declares both parts before any data. The loop cannot name an effect that
changes the readings less than these parts.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from calibration.inference.intervals import noise_floor
from slider_jax.channels import CHANNELS
from slider_jax.experiment.schema import SensorsTable

DISCREPANCY_TIME = 0.02
"""Correlation time of the model-discretisation discrepancy within a stride [s]. It depends on the
beam, not on the drive."""
DISCREPANCY_STRIDES = 10.0
"""Number of strides over which the discrepancy stays correlated, so that more strides do not reduce
it. The correlation that was measured after one stride is 0.86 to 0.94."""
MAX_SAMPLES = 1250
"""Largest number of samples in a whitened series, to limit the Cholesky factor's size. Longer
series are averaged in groups."""


class Noise(NamedTuple):
    """Standard deviations of one channel, in its unit."""

    white: float
    slow: float = 0.0
    slow_time: float = 0.1
    tare: float = 0.0


def channel_noise(sensors: SensorsTable, channel: str, values: np.ndarray) -> Noise:
    """Returns the noise that an experiment declares for a channel.

    If the experiment declares no white noise, the noise is estimated from the measured `values`
    (n,). For a pressure, the smallest step between values is the quantisation.
    """
    key, kind = CHANNELS[channel].noise, CHANNELS[channel].kind
    white = getattr(sensors, key) if key else 0.0
    there = values[np.isfinite(values)]
    if white == 0.0:
        white = max(noise_floor(there), 1e-9 * max(float(np.ptp(there)), 1e-12))
    elif kind == "pressure":
        white = float(np.hypot(white, quantisation_step(there) / np.sqrt(12.0)))
    if kind == "camera":
        # While the robot still swings, its initial position is not its rest position.
        return Noise(white, tare=sensors.start_swing)
    if kind == "force":
        return Noise(white, sensors.force_slow_noise, sensors.force_slow_time, sensors.force_tare)
    return Noise(white)


def quantisation_step(values: np.ndarray) -> float:
    """Returns the step of which all differences of values are multiples, or 0 if none exists."""
    steps = np.diff(np.unique(values))
    steps = steps[steps > 1e-12 * max(float(np.ptp(values)), 1e-300)]
    if not steps.size:
        return 0.0
    least = float(np.median(steps[steps < 1.5 * steps.min()]))
    off = np.abs(steps / least - np.round(steps / least))
    return least if np.mean(off < 0.05) > 0.95 else 0.0


class Whitener:
    """Whitens series of one trial and channel: independent samples of unit variance.

    `t` (n,) [s] are the sample times. `model` (n,) is the model's series; it scales the noise that
    is proportional to the signal. If the drive's `frequency` [Hz] is given, the
    model-discretisation discrepancy repeats with it. Tare, gain and `spans` (k, n) are
    marginalised. A span is a series with an unknown factor of unit variance.
    """

    def __init__(
        self,
        t: np.ndarray,
        noise: Noise,
        model: np.ndarray,
        channel: str,
        frequency: float | None = None,
        spans: np.ndarray | None = None,
    ):
        self._group = max(1, int(np.ceil(len(t) / MAX_SAMPLES)))
        n = len(t) // self._group * self._group
        self._n = n
        centre, y = self._averaged(t[None])[0], self._averaged(model[None])[0]
        rms = float(np.std(y)) if len(y) > 1 else 0.0
        lag = np.abs(centre[:, None] - centre[None])
        cov = noise.slow**2 * np.exp(-lag / noise.slow_time)
        scale = CHANNELS[channel].discrepancy * rms
        cov += scale**2 * _discrepancy_correlation(lag, frequency)
        cov += noise.tare**2 + CHANNELS[channel].gain ** 2 * np.outer(y, y)
        if spans is not None:
            unknown = self._averaged(spans)
            cov += unknown.T @ unknown
        cov[np.diag_indices_from(cov)] += noise.white**2 / self._group
        self._factor = cholesky(cov, lower=True)

    def _averaged(self, series: np.ndarray) -> np.ndarray:
        return series[:, : self._n].reshape(len(series), -1, self._group).mean(axis=2)

    def __call__(self, series: np.ndarray) -> np.ndarray:
        """Returns the whitened series (k, m) of `series` (k, n); non-finite values are kept."""
        averaged = self._averaged(np.atleast_2d(series))
        return solve_triangular(self._factor, averaged.T, lower=True, check_finite=False).T


def _discrepancy_correlation(lag: np.ndarray, frequency: float | None) -> np.ndarray:
    """Returns the correlation of the model-discretisation discrepancy at a time `lag` [s].

    The correlation decreases exponentially with the chord between two phases on a circle, so that
    it is high again after each stride. It also decreases slowly from stride to stride.
    """
    if not frequency:
        return np.exp(-lag / DISCREPANCY_TIME)
    chord = np.abs(np.sin(np.pi * frequency * lag)) / (np.pi * frequency)
    return np.exp(-chord / DISCREPANCY_TIME - lag * frequency / DISCREPANCY_STRIDES)
