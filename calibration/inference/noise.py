"""The noise of a channel, and residuals made white by it.

A sensor's noise is white (with the quantisation's share), slow (correlated over `slow_time`), and a
tare that is constant over a trial. Beside it stand two shares of the signal itself that no sensor
declares: a gain that differs from trial to trial, and what two correct programs of one model still
differ by. Both are declared here, before any data are looked at; an effect smaller than they are
cannot be named.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from calibration.inference.intervals import noise_floor
from slider_jax.channels import CHANNELS
from slider_jax.experiment.schema import SensorsTable

DISCREPANCY_TIME = 0.02
"""Correlation time within a stride [s] of the difference between two correct programs: the beam's,
not the drive's."""
STRIDES = 10.0
"""Strides over which that difference stays the same, so that they do not average it out. After one
stride 0.86 to 0.94 of it is the same."""
LONGEST = 1250
"""Samples of a series that are whitened at once; longer ones are averaged in groups first."""


class Noise(NamedTuple):
    """Standard deviations of one channel, in its unit."""

    white: float
    slow: float = 0.0
    slow_time: float = 0.1
    tare: float = 0.0


def declared(sensors: SensorsTable, channel: str, values: np.ndarray) -> Noise:
    """Noise that an experiment declares for a channel; white noise is measured where it does not.

    The quantisation is read off the data: the least step between their values.
    """
    key, kind = CHANNELS[channel].noise, CHANNELS[channel].kind
    white = getattr(sensors, key) if key else 0.0
    there = values[np.isfinite(values)]
    if white == 0.0:
        white = max(noise_floor(there), 1e-9 * max(float(np.ptp(there)), 1e-12))
    elif kind == "pressure":
        white = float(np.hypot(white, quantum(there) / np.sqrt(12.0)))
    if kind == "camera":
        # Where the robot still swings, its place at rest is not that of the moment.
        return Noise(white, tare=sensors.start_swing)
    if kind == "force":
        return Noise(white, sensors.force_slow_noise, sensors.force_slow_time, sensors.force_tare)
    return Noise(white)


def quantum(values: np.ndarray) -> float:
    """The step that all differences of the values are multiples of, or 0 where there is none."""
    steps = np.diff(np.unique(values))
    steps = steps[steps > 1e-12 * max(float(np.ptp(values)), 1e-300)]
    if not steps.size:
        return 0.0
    least = float(np.median(steps[steps < 1.5 * steps.min()]))
    off = np.abs(steps / least - np.round(steps / least))
    return least if np.mean(off < 0.05) > 0.95 else 0.0


class Whitener:
    """Makes series of one trial and channel white: independent, of unit variance.

    `t` (n,) [s] are the times of the samples that are there; `model` (n,) the model's series, which
    scales what is a share of the signal; `frequency` [Hz] the drive's, with which the difference of
    correct programs comes back. Tare and gain are marginalised, and so are `spans` (k, n): series
    of unknown size, each as its standard deviation.
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
        self._group = max(1, int(np.ceil(len(t) / LONGEST)))
        n = len(t) // self._group * self._group
        self._n = n
        centre, y = self._averaged(t[None])[0], self._averaged(model[None])[0]
        rms = float(np.std(y)) if len(y) > 1 else 0.0
        apart = np.abs(centre[:, None] - centre[None])
        cov = noise.slow**2 * np.exp(-apart / noise.slow_time)
        cov += (CHANNELS[channel].discrepancy * rms) ** 2 * _difference(apart, frequency)
        cov += noise.tare**2 + CHANNELS[channel].gain ** 2 * np.outer(y, y)
        if spans is not None:
            unknown = self._averaged(spans)
            cov += unknown.T @ unknown
        cov[np.diag_indices_from(cov)] += noise.white**2 / self._group
        self._factor = cholesky(cov, lower=True)

    def _averaged(self, series: np.ndarray) -> np.ndarray:
        return series[:, : self._n].reshape(len(series), -1, self._group).mean(axis=2)

    def __call__(self, series: np.ndarray) -> np.ndarray:
        """White series (k, m) of `series` (k, n); what is not finite stays so."""
        averaged = self._averaged(np.atleast_2d(series))
        return solve_triangular(self._factor, averaged.T, lower=True, check_finite=False).T


def _difference(apart: np.ndarray, frequency: float | None) -> np.ndarray:
    """Correlation of the difference of correct programs at times so far `apart` [s].

    Exponential in the chord of the stride's circle, so that it comes back after a stride, and
    slowly forgotten over strides.
    """
    if not frequency:
        return np.exp(-apart / DISCREPANCY_TIME)
    chord = np.abs(np.sin(np.pi * frequency * apart)) / (np.pi * frequency)
    return np.exp(-chord / DISCREPANCY_TIME - apart * frequency / STRIDES)
