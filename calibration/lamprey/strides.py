"""Whole strides of a motion that has a travelling wave, and the gait's numbers."""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from calibration.lamprey.motion import Motion
from slider_jax.errors import InputError
from slider_jax.observables import body_wave, strouhal_number, travelling_index

EDGE = 3
"""Frames left out at either end, where a smoothing spline's derivatives are poor."""
FEWEST = 3
"""Whole strides without which nothing is said."""


class Strides(NamedTuple):
    """Times at which one phase of the wave recurs."""

    marks: np.ndarray
    """(strides + 1,) [s]"""
    phase: np.ndarray
    """(times,) [turns], increasing by 1 from mark to mark."""

    @property
    def number(self) -> int:
        return len(self.marks) - 1

    @property
    def frequency(self) -> float:
        """Mean [Hz] over the strides."""
        return self.number / float(self.marks[-1] - self.marks[0])

    def means(self, t: np.ndarray, series: np.ndarray) -> np.ndarray:
        """(strides, ...): the mean of a series (times, ...) over each stride."""
        steps = 0.5 * (series[1:] + series[:-1]) * _column(np.diff(t), series)
        total = np.concatenate([np.zeros_like(series[:1]), np.cumsum(steps, axis=0)])
        return np.diff(_at(self.marks, t, total), axis=0) / _column(np.diff(self.marks), series)

    def gains(self, t: np.ndarray, series: np.ndarray) -> np.ndarray:
        """(strides, ...): the mean rate of change of a series over each stride."""
        spans = _column(np.diff(self.marks), series)
        return np.diff(_at(self.marks, t, series), axis=0) / spans


class AnimalGait(NamedTuple):
    """How an animal swims; SI units."""

    speed: float
    """[m/s] of the body's middle, along `direction`."""
    direction: np.ndarray
    """(2,) unit vector of the mean course over whole strides."""
    frequency: float
    tail_amplitude: float
    """Of the tail's fundamental [m], half a stroke."""
    wavelength: float
    """[m], along the body."""
    wave_speed: float
    travelling_index: float
    strouhal: float
    reynolds: float


def find_strides(motion: Motion) -> Strides:
    """The strides that lie whole within a motion, less its edges.

    The phase is the angle in the plane of the two leading modes of phi(s, t), which a travelling
    wave goes round. Raises `InputError` where fewer than three strides are whole.
    """
    t = np.asarray(motion.t)
    trend = np.polynomial.polynomial.polyvander(t - t.mean(), 2)
    free = motion.phi - trend @ np.linalg.lstsq(trend, motion.phi, rcond=None)[0]
    modes, _, _ = np.linalg.svd(free, full_matrices=False)
    a, b = (modes[:, i] / np.std(modes[:, i]) for i in (0, 1))
    turns = np.unwrap(np.arctan2(b, a)) / (2.0 * math.pi)
    phase = turns * np.sign(turns[-1] - turns[0])
    inner = slice(EDGE, len(t) - EDGE)
    rising = np.maximum.accumulate(phase[inner])
    whole = math.floor(rising[-1] - rising[0] + 1e-9)
    if whole < FEWEST:
        raise InputError(
            f"midlines: {max(whole, 0)} whole strides in {t[inner][-1] - t[inner][0]:.2f} s; "
            f"allowed {FEWEST} or more; give a longer record of steady swimming"
        )
    # Late strides are kept: a record may begin while the animal still gets going.
    first = rising[-1] - whole
    marks = np.interp(first + np.arange(whole + 1.0), rising, t[inner])
    return Strides(marks, phase - first)


def gait(motion: Motion, strides: Strides, viscosity: float) -> AnimalGait:
    """The numbers of a gait over its whole strides."""
    t, s = np.asarray(motion.t), motion.s
    middle = np.trapezoid(motion.r, s, axis=1) / motion.length
    ends = _at(strides.marks[[0, -1]], t, middle)
    way, span = ends[1] - ends[0], strides.marks[-1] - strides.marks[0]
    direction = way / np.hypot(*way)
    speed, f = float(np.hypot(*way) / span), strides.frequency
    lateral = motion.r @ np.array([-direction[1], direction[0]])
    mode = fundamental(t, lateral, strides)
    wave = body_wave(jnp.asarray(mode), jnp.asarray(s), f)
    amplitude = float(abs(mode[0]))
    return AnimalGait(
        speed=speed,
        direction=direction,
        frequency=f,
        tail_amplitude=amplitude,
        wavelength=float(wave.wavelength),
        wave_speed=float(wave.speed),
        travelling_index=float(travelling_index(jnp.asarray(mode))),
        strouhal=float(strouhal_number(f, 2.0 * amplitude, speed)),
        reynolds=speed * motion.length / viscosity,
    )


def fundamental(t: np.ndarray, series: np.ndarray, strides: Strides) -> np.ndarray:
    """Complex amplitude (nodes,) at the strides' phase of a series (times, nodes), detrended."""
    here = (t >= strides.marks[0]) & (t <= strides.marks[-1])
    turn, at = 2.0 * math.pi * strides.phase[here], t[here] - t[here].mean()
    basis = np.stack([np.ones_like(at), at, at**2, np.cos(turn), np.sin(turn)], axis=1)
    found = np.linalg.lstsq(basis, series[here], rcond=None)[0]
    return found[3] - 1j * found[4]


def _column(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    return values.reshape(-1, *[1] * (like.ndim - 1))


def _at(times: np.ndarray, t: np.ndarray, series: np.ndarray) -> np.ndarray:
    flat = series.reshape(len(t), -1)
    columns = [np.interp(times, t, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(len(times), *series.shape[1:])
