"""Computes the wavelength of a swimmer's stride, by several definitions."""

import jax.numpy as jnp
import numpy as np

from slider_jax import observables as obs
from slider_jax.swimming.performance import Stride


def course_coordinates(stride: Stride) -> tuple[np.ndarray, np.ndarray]:
    """Returns positions (steps, nodes) [m] along and left of the course.

    The positions to the left have zero mean over the stride.
    """
    x, y = np.moveaxis(np.asarray(stride.midline), 1, 0)
    along = np.asarray(stride.velocity).mean(axis=0)
    along = along / np.hypot(*along) * np.sign(along @ np.asarray(stride.ahead))
    across = along[0] * y - along[1] * x
    return along[0] * x + along[1] * y, across - across.mean(axis=0)


def zeros_wavelength(y: np.ndarray, s: np.ndarray) -> float:
    """Returns twice the mean distance [m] between neighbouring zeros of shapes y (times, points).

    Each shape's weight is its mean square, so that nearly straight shapes, whose zeros are
    inaccurate, have little influence. Returns NaN if no shape has two zeros. `s` is in m.
    """
    lengths, weights = [], []
    for row in y:
        (i,) = np.nonzero((row[1:] < 0.0) != (row[:-1] < 0.0))
        zeros = s[i] + (s[i + 1] - s[i]) * row[i] / (row[i] - row[i + 1])
        if len(zeros) > 1:
            lengths.append(2.0 * np.diff(zeros).mean())
            weights.append((row**2).mean())
    return float(np.average(lengths, weights=weights)) if lengths else float("nan")


def without_recoil(y: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Returns the shapes y (times, points), each minus its fitted straight line."""
    line = np.stack([np.ones_like(s), s], axis=1)
    return y - (line @ np.linalg.lstsq(line, y.T, rcond=None)[0]).T


def wavelengths(stride: Stride, s: np.ndarray, frequency: float) -> dict[str, float]:
    """Returns the wavelength [m] of a stride for each definition.

    Wavelengths that follow from a phase are negative if the wave travels towards the head.
    """
    along, y = course_coordinates(stride)
    t = jnp.asarray(stride.t)

    def mode(y: np.ndarray):
        return obs.fundamental_mode(jnp.asarray(y), t, frequency)

    def by_phase(y: np.ndarray, s: np.ndarray) -> float:
        return float(obs.body_wave(mode(y), jnp.asarray(s), frequency).wavelength)

    angle, rear = np.arctan2(np.diff(y), np.diff(along)), s <= s[-1] / 3.0
    middle = 0.5 * (s[1:] + s[:-1])
    return {
        "phase": by_phase(y, s),
        "phase, rear third": by_phase(y[:, rear], s[rear]),
        "phase, recoil removed": by_phase(without_recoil(y, s), s),
        "phase of the curvature": by_phase(np.diff(angle) / np.diff(middle), s[1:-1]),
        "shape": float(obs.shape_wavelength(mode(y), jnp.asarray(s))),
        "zeros": zeros_wavelength(y, s),
        "zeros, recoil removed": zeros_wavelength(without_recoil(y, s), s),
    }
