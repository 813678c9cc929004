"""Finds the whole strides of a swimming animal's motion, and computes quantities of the gait."""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from calibration.lamprey.motion import Motion
from slider_jax.errors import InputError
from slider_jax.observables import body_wave, strouhal_number, travelling_index

EDGE_FRAMES = 3
"""Number of frames omitted at each end, where derivatives of a smoothing spline are inaccurate."""
MIN_STRIDES = 3
"""With fewer whole strides, the spread between strides cannot be estimated."""


class Strides(NamedTuple):
    """The whole strides of a motion."""

    marks: np.ndarray
    """Times (strides + 1,) [s] of the ends of the strides, all with the same phase of the wave."""
    phase: np.ndarray
    """Phase (times,) [turns] of the travelling wave. The phase increases by 1 in every stride."""

    @property
    def number(self) -> int:
        return len(self.marks) - 1

    @property
    def frequency(self) -> float:
        """Mean frequency [Hz] of the strides."""
        return self.number / float(self.marks[-1] - self.marks[0])

    def means(self, t: np.ndarray, series: np.ndarray) -> np.ndarray:
        """Returns the mean (strides, ...) of `series` (times, ...) in each stride."""
        steps = 0.5 * (series[1:] + series[:-1]) * _column(np.diff(t), series)
        total = np.concatenate([np.zeros_like(series[:1]), np.cumsum(steps, axis=0)])
        return np.diff(_interpolate(self.marks, t, total), axis=0) / _column(
            np.diff(self.marks), series
        )

    def gains(self, t: np.ndarray, series: np.ndarray) -> np.ndarray:
        """Returns the change per second (strides, ...) of `series` (times, ...) in each stride."""
        spans = _column(np.diff(self.marks), series)
        return np.diff(_interpolate(self.marks, t, series), axis=0) / spans


class AnimalGait(NamedTuple):
    """Quantities of an animal's gait in SI units."""

    speed: float
    """Mean speed [m/s] of the body along `direction`."""
    direction: np.ndarray
    """Unit vector (2,) of the mean course over whole strides."""
    frequency: float
    tail_amplitude: float
    """Amplitude [m] of the tail's lateral motion at the stride frequency."""
    wavelength: float
    """Wavelength [m] of the wave along the body."""
    wave_speed: float
    travelling_index: float
    strouhal: float
    reynolds: float


def whole_strides(motion: Motion) -> Strides:
    """Returns the whole strides of a motion without the first and last `EDGE_FRAMES` frames.

    The amplitudes a(t) and b(t) of the two leading modes of phi(s, t) trace a closed loop. The
    phase is the angle of point (a, b). Raises `InputError` for fewer than `MIN_STRIDES` strides.
    """
    t = np.asarray(motion.t)
    trend = np.polynomial.polynomial.polyvander(t - t.mean(), 2)
    free = motion.phi - trend @ np.linalg.lstsq(trend, motion.phi, rcond=None)[0]
    modes, _, _ = np.linalg.svd(free, full_matrices=False)
    a, b = (modes[:, i] / np.std(modes[:, i]) for i in (0, 1))
    turns = np.unwrap(np.arctan2(b, a)) / (2.0 * math.pi)
    phase = turns * np.sign(turns[-1] - turns[0])
    inner = slice(EDGE_FRAMES, len(t) - EDGE_FRAMES)
    rising = np.maximum.accumulate(phase[inner])
    whole = math.floor(rising[-1] - rising[0] + 1e-9)
    if whole < MIN_STRIDES:
        raise InputError(
            f"midlines: {max(whole, 0)} whole strides in {t[inner][-1] - t[inner][0]:.2f} s; "
            f"at least {MIN_STRIDES} are required; use a longer record of steady swimming"
        )
    # The last strides are used, because the animal may still accelerate in the first strides.
    first = rising[-1] - whole
    marks = np.interp(first + np.arange(whole + 1.0), rising, t[inner])
    return Strides(marks, phase - first)


def animal_gait(motion: Motion, strides: Strides, viscosity: float) -> AnimalGait:
    """Returns the gait of a motion in the whole strides `strides`; `viscosity` is in m^2/s."""
    t, s = np.asarray(motion.t), motion.s
    middle = np.trapezoid(motion.r, s, axis=1) / motion.length
    ends = _interpolate(strides.marks[[0, -1]], t, middle)
    displacement, duration = ends[1] - ends[0], strides.marks[-1] - strides.marks[0]
    distance = np.hypot(*displacement)
    direction = displacement / distance
    speed, f = float(distance / duration), strides.frequency
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
    """Returns the complex amplitude (nodes,) of `series` (times, nodes) at the stride frequency."""
    inside = (t >= strides.marks[0]) & (t <= strides.marks[-1])
    angle, at = 2.0 * math.pi * strides.phase[inside], t[inside] - t[inside].mean()
    basis = np.stack([np.ones_like(at), at, at**2, np.cos(angle), np.sin(angle)], axis=1)
    fitted = np.linalg.lstsq(basis, series[inside], rcond=None)[0]
    return fitted[3] - 1j * fitted[4]


def _column(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    return values.reshape(-1, *[1] * (like.ndim - 1))


def _interpolate(times: np.ndarray, t: np.ndarray, series: np.ndarray) -> np.ndarray:
    flat = series.reshape(len(t), -1)
    columns = [np.interp(times, t, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(len(times), *series.shape[1:])
