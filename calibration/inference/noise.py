"""Noise model of a channel, and the whitening of residuals.

A sensor's noise has three parts: white noise (with quantisation), slow noise with the correlation
time `slow_time`, and a tare that is constant in a trial. Two further parts are proportional to the
signal: a gain that differs between trials, and the model-discretisation discrepancy. Both sizes are
constants of `slider_jax.channels`. An effect smaller than these two parts cannot be identified.
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
"""Number of strides in which the discrepancy's correlation decreases to 1/e. The measured
correlation of successive strides is 0.86 to 0.94, so a mean over strides hardly reduces it."""
MAX_SAMPLES = 1250
"""Largest number of samples in a whitened series. Neighbouring samples of longer series are
averaged in groups, to limit the size of the covariance matrix."""


class Noise(NamedTuple):
    """Standard deviations of one channel's noise, in the unit of the channel; `slow_time` in s."""

    white: float
    slow: float = 0.0
    slow_time: float = 0.1
    tare: float = 0.0


def channel_noise(sensors: SensorsTable, channel: str, values: np.ndarray) -> Noise:
    """Returns the noise that an experiment declares for a channel.

    If the experiment declares no white noise, the white noise is estimated from the measured
    `values` (n,). The declared white noise of a pressure is increased by the quantisation noise.
    """
    key, kind = CHANNELS[channel].noise, CHANNELS[channel].kind
    white = getattr(sensors, key) if key else 0.0
    there = values[np.isfinite(values)]
    if white == 0.0:
        white = max(noise_floor(there), 1e-9 * max(float(np.ptp(there)), 1e-12))
    elif kind == "pressure":
        white = float(np.hypot(white, quantisation_step(there) / np.sqrt(12.0)))
    if kind == "camera":
        # A robot that still swings at the start is not at rest, so the tip's tare has an error.
        return Noise(white, tare=sensors.start_swing)
    if kind == "force":
        return Noise(white, sensors.force_slow_noise, sensors.force_slow_time, sensors.force_tare)
    return Noise(white)


def quantisation_step(values: np.ndarray) -> float:
    """Returns the quantisation step of `values`, or 0 if the differences have no common divisor."""
    steps = np.diff(np.unique(values))
    steps = steps[steps > 1e-12 * max(float(np.ptp(values)), 1e-300)]
    if not steps.size:
        return 0.0
    least = float(np.median(steps[steps < 1.5 * steps.min()]))
    off = np.abs(steps / least - np.round(steps / least))
    return least if np.mean(off < 0.05) > 0.95 else 0.0


class Whitener:
    """Transforms series of one trial and channel to independent samples of unit variance.

    `t` (n,) [s] are the sample times. `model` (n,) are the predicted readings, which scale the
    noise that is proportional to the signal. If `frequency` [Hz] is given, the model-discretisation
    discrepancy is correlated between strides. Tare, gain and `spans` (k, n) are marginalised. Each
    span is a series that is multiplied by an unknown random factor of unit variance.
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
        """Returns the whitened series (k, m) of `series` (k, n). NaN and inf raise no error."""
        averaged = self._averaged(np.atleast_2d(series))
        return solve_triangular(self._factor, averaged.T, lower=True, check_finite=False).T


def _discrepancy_correlation(lag: np.ndarray, frequency: float | None) -> np.ndarray:
    """Returns the correlation of the model-discretisation discrepancy at a time `lag` [s].

    Within a stride, the correlation decreases exponentially with the chord between two phases on a
    circle. The correlation is high again after each stride, but lower with every further stride.
    """
    if not frequency:
        return np.exp(-lag / DISCREPANCY_TIME)
    chord = np.abs(np.sin(np.pi * frequency * lag)) / (np.pi * frequency)
    return np.exp(-chord / DISCREPANCY_TIME - lag * frequency / DISCREPANCY_STRIDES)
