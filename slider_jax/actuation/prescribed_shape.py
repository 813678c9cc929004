"""Actuators that force the body to follow a curvature: a travelling wave, or recorded samples."""

import math
from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.actuation.actuator import Actuator
from slider_jax.beam.parameters import Scalar
from slider_jax.errors import InputError


class PrescribedShape(Actuator):
    """An actuator that forces the body to follow a curvature, whatever moment is necessary.

    In the cells whose middles are in the span, the moment law M = EI kappa - M_act is replaced by

        d(kappa)/dt = d(kappa_p)/dt,        kappa = kappa_p at the start.

    M is then the moment of the actuator and the body together. If spans overlap, the last actuator
    of the model acts. The time scheme integrates the rate, so kappa differs from kappa_p by an
    error of the order of the scheme, which does not grow with time. `dynamics.shapes` explains why
    the rate is prescribed. A rollout that begins at a given state keeps the difference between
    kappa and kappa_p in this state.
    """

    @abstractmethod
    def curvature(self, distance: Float[Array, " cells"], t: Array) -> Float[Array, " cells"]:
        """Returns kappa_p [1/m] at `distance` [m] from the head and the time `t` [s].

        The second derivative with respect to `t` must exist. JAX computes this derivative.
        """


class TravellingWave(PrescribedShape):
    """The curvature kappa_p = A(d) sin(2 pi (f t - d/lambda - phase)) + bias.

    d [m] is the distance from the head and A(d) = a_0 + a_1 d + a_2 d^2. Positive f and lambda
    give a wave that travels from the head to the tail. The `bias` steers.
    """

    frequency: Scalar
    """f [Hz]."""
    wavelength: Scalar
    """lambda [m]."""
    amplitude: tuple[Scalar, Scalar, Scalar]
    """a_0 [1/m], a_1 [1/m^2] and a_2 [1/m^3]."""
    phase: Scalar = eqx.field(default=0.0)
    """Delay as a fraction of a period."""
    bias: Scalar = eqx.field(default=0.0)
    """Mean curvature [1/m]."""

    def curvature(self, distance, t):
        a_0, a_1, a_2 = self.amplitude
        envelope = a_0 + distance * (a_1 + distance * a_2)
        turns = self.frequency * t - distance / self.wavelength - self.phase
        return envelope * jnp.sin(2.0 * math.pi * turns) + self.bias


class RecordedShape(PrescribedShape):
    """Samples of the curvature, interpolated by cubic splines in time and linearly in space.

    The curvature and its first two time derivatives are continuous from the first to the last
    sample. Outside these times and distances, the curvature is constant. Build the shape with
    `recorded_shape` or `midline_shape`.
    """

    distances: Float[Array, " points"]
    """Distances of the samples from the head [m], increasing."""
    times: Float[Array, " samples"]
    """Times of the samples [s], increasing."""
    coefficients: Float[Array, "4 intervals points"]
    """Coefficients of the cubic polynomials of t - (start of the interval), cubic term first."""

    def curvature(self, distance, t):
        t = jnp.clip(t, self.times[0], self.times[-1])
        last = self.times.shape[0] - 2
        i = jnp.clip(jnp.searchsorted(self.times, t, side="right") - 1, 0, last)
        x, (c3, c2, c1, c0) = t - self.times[i], self.coefficients[:, i]
        return jnp.interp(distance, self.distances, c0 + x * (c1 + x * (c2 + x * c3)))


def recorded_shape(
    near: Scalar, far: Scalar, distances: np.ndarray, times: np.ndarray, curvature: np.ndarray
) -> RecordedShape:
    """Returns the shape with the samples `curvature` (samples, points) [1/m].

    `distances` (points,) [m] and `times` (samples,) [s] are increasing. Raises `InputError` for
    other samples.
    """
    distances, times, curvature = (np.asarray(x, float) for x in (distances, times, curvature))
    for name, values, least in (("distances", distances, 1), ("times", times, 4)):
        if values.ndim != 1 or len(values) < least or np.any(np.diff(values) <= 0.0):
            raise InputError(
                f"{name} of a recorded shape: given an array of shape {values.shape}; allowed an "
                f"increasing series of at least {least} numbers; sort the samples"
            )
    if curvature.shape != (len(times), len(distances)) or not np.all(np.isfinite(curvature)):
        raise InputError(
            f"curvature of a recorded shape: given an array of shape {curvature.shape}; allowed "
            f"finite numbers of shape {(len(times), len(distances))}, one row for each time"
        )
    from scipy.interpolate import CubicSpline  # few robots need this import, which takes 0.2 s

    spline = CubicSpline(times, curvature)
    return RecordedShape(
        near, far, jnp.asarray(distances), jnp.asarray(times), jnp.asarray(spline.c)
    )


def midline_shape(times: np.ndarray, midline: np.ndarray) -> RecordedShape:
    """Returns the shape of a recorded `midline` (samples, 2, points) [m], tail first.

    The curvature at an inner point is the change of angle between the two neighbouring chords,
    divided by half the sum of their lengths. The span is the mean length of the midline. The
    curvature amplifies noise in the midline, so smooth noisy points before. The support of the
    model determines the motion of the head. Raises `InputError` for samples without curvature.
    """
    midline = np.asarray(midline, float)
    if midline.ndim != 3 or midline.shape[1] != 2 or midline.shape[2] < 3:
        raise InputError(
            f"recorded midline: given an array of shape {midline.shape}; allowed (samples, 2, "
            "points) with at least 3 points"
        )
    chords = np.diff(midline[:, :, ::-1], axis=2)  # head first, directed to the tail
    lengths = np.hypot(chords[:, 0], chords[:, 1])
    angles = np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]), axis=1)
    # The angle phi of tau increases towards the head, and these chords point to the tail.
    curvature = -np.diff(angles, axis=1) / (0.5 * (lengths[:, 1:] + lengths[:, :-1]))
    ends = np.cumsum(lengths.mean(axis=0))
    return recorded_shape(0.0, float(ends[-1]), ends[:-1], times, curvature)
