"""Functions that several effects share: smooth limits, powers, and delays, lags and resonances."""

import math
from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.equations import Section
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Readings, parameter, shape_parameter

WHY_FACTOR = "20 times the unit of a term is more than any known law adds"
WHY_FREQUENCY = "usual sample rates resolve these"
WHY_DRIFT = "no property of a robot changes by more than its typical value during a trial"
MEMORY_TIMES = (0.03, 0.3, 3.0)
"""Time constants [s] of a memory: from the fastest strides to a whole trial."""
LIMIT_EXPONENT = 32
"""Exponent of the function `limited`. Compared with a hard limit, the result is 2 % smaller for an
x at the limit, and 0.1 % smaller for an x at 90 % of the limit."""


def magnitude(x: Array, width: float) -> Array:
    """Returns |x| with a smooth corner at x = 0: sqrt(x^2 + width^2)."""
    return jnp.sqrt(x**2 + width**2)


def signed_root(x: Array, width: float) -> Array:
    """Returns sign(x) |x|^(1/2) with a smooth corner at x = 0: x/(x^2 + width^2)^(1/4)."""
    return x / jnp.sqrt(magnitude(x, width))


def limited(x: Array, inverse: Array) -> Array:
    """Returns x, limited smoothly to the range +-1/inverse: x/(1 + |inverse x|^32)^(1/32)."""
    return x / (1.0 + (inverse * x) ** LIMIT_EXPONENT) ** (1.0 / LIMIT_EXPONENT)


def delayed(x: Float[Array, " n"], t: Float[Array, " n"], delay: Scalar) -> Float[Array, " n"]:
    """Returns x(t - delay) at the times `t` [s]; before and after these times, x is constant.

    The interpolation is cubic Hermite with central differences as slopes, so the derivative with
    respect to `delay` [s] is continuous, also at a delay of zero. `delay` may be negative.
    """
    last = x.shape[0] - 1
    place = jnp.arange(last + 1.0) - delay / (t[1] - t[0])
    cell = jnp.floor(place)
    u = place - cell
    x0, x1, x2, x3 = (x[jnp.clip(cell + i, 0.0, float(last)).astype(int)] for i in (-1, 0, 1, 2))
    slope1, slope2 = 0.5 * (x2 - x0), 0.5 * (x3 - x1)
    curve = 3.0 * (x2 - x1) - 2.0 * slope1 - slope2
    twist = 2.0 * (x1 - x2) + slope1 + slope2
    return x1 + u * (slope1 + u * (curve + u * twist))


def lag_coefficients(tau: Scalar, dt: Array) -> tuple[Array, Array]:
    """Returns the decay e = exp(-dt/tau) in a step `dt` [s], and the mean decay (1 - e) tau/dt.

    `tau` [s] is the time constant. At tau = 0, the decay and the mean decay are zero, and the
    derivative of the mean decay with respect to tau is 1/dt.
    """
    # For tau < dt/500, the decay is below 1e-217 and set to zero; the mean decay is tau/dt.
    slow = tau > dt / 500.0
    exponent = dt / jnp.where(slow, tau, dt)
    e = jnp.where(slow, jnp.exp(-exponent), 0.0)
    return e, jnp.where(slow, -jnp.expm1(-exponent), 1.0) * tau / dt


def lagged(
    x: Float[Array, " n"], t: Float[Array, " n"], tau: Scalar, start: Array | None = None
) -> Float[Array, " n"]:
    """Returns the solution y of tau dy/dt = x - y from y = `start` (default: the first x).

    The solution is exact if x is linear between samples. From sample 0 to sample 1, the solution is

        y_1 = e y_0 + (1 - e) x_0 + (1 - m) (x_1 - x_0)

    e and m are the decay and the mean decay of `lag_coefficients`. At tau = 0, y is x and the
    derivative of y with respect to tau is -dx/dt.
    """
    e, m = lag_coefficients(tau, t[1] - t[0])

    def body(y, ends):
        x_0, x_1 = ends
        # e and m are zero at tau = 0, so this form returns x_1 without a rounding error.
        y = x_1 + e * (y - x_0) - m * (x_1 - x_0)
        return y, y

    first = x[0] if start is None else start
    _, rest = jax.lax.scan(body, first, (x[:-1], x[1:]))
    return jnp.concatenate([first[None], rest])


def lagged_sample(
    x: Float[Array, " n"], t: Float[Array, " n"], tau: Scalar, y: Float[Array, " m"]
) -> Array:
    """Returns the last sample of `lagged`, computed from the previous samples `y` of `lagged`."""
    return lagged(x[-2:], t[-2:], tau, y[-1])[-1]


def _resonant_next(before: tuple[Array, ...], x: Array, dt: Array, c: Scalar, b: Scalar) -> Array:
    """Returns the next y of `resonant` from the last three y in `before`, latest first."""
    inertia = c / dt**2
    damping = c * b / (6.0 * dt)
    y1, y2, y3 = before
    held = inertia * (5.0 * y1 - 4.0 * y2 + y3)
    held = held + damping * (18.0 * y1 - 9.0 * y2 + 2.0 * y3)
    return (x + held) / (1.0 + 2.0 * inertia + 11.0 * damping)


def resonant(x: Float[Array, " n"], t: Float[Array, " n"], c: Scalar, b: Scalar) -> Array:
    """Returns the solution y of the damped oscillator c (y'' + b y') + y = x, from rest at x[0].

    y is a smooth function of `c` [s^2] at c = 0. Houbolt's backward differences in time are
    second-order and stable for any step. If the natural frequency 1/(2 pi sqrt(c)) is too high for
    the sample rate, y equals x. `b` [1/s] is the damping rate.
    """
    dt = t[1] - t[0]

    def body(before, x):
        y = _resonant_next(before, x, dt, c, b)
        return (y, *before[:2]), y

    return jax.lax.scan(body, (x[0],) * 3, x)[1]


def resonant_sample(
    x: Float[Array, " n"], t: Float[Array, " n"], c: Scalar, b: Scalar, y: Float[Array, " m"]
) -> Array:
    """Returns the last sample of `resonant`, computed from the previous samples `y`."""
    return _resonant_next((y[-1], y[-2], y[-3]), x[-1], t[-1] - t[-2], c, b)


Basis = tuple[Array, Array, Array]
"""Values of three functions of a state. One array of all values would need more time to compile."""


def odd_powers(z: Array, factor: float | Scalar = 1.0) -> Basis:
    """Returns z, z |z| and z^3, times `factor`. Beyond -1 and 1, each function is constant."""
    z = jnp.clip(z, -1.0, 1.0)
    return factor * z, factor * z * jnp.abs(z), factor * z**3


def even_powers(z: Array, factor: float | Scalar = 1.0) -> Basis:
    """Returns |z|, z^2 and |z|^3, times `factor`. Beyond -1 and 1, each function is constant."""
    size = jnp.minimum(jnp.abs(z), 1.0)
    return factor * size, factor * size**2, factor * size**3


def mixed_powers(z: Array, factor: float | Scalar = 1.0) -> Basis:
    """Returns z, |z| and z^2, times `factor`. Beyond -1 and 1, each function is constant."""
    z = jnp.clip(z, -1.0, 1.0)
    return factor * z, factor * jnp.abs(z), factor * z**2


def odd_corners(z: Array, factor: float | Scalar = 1.0) -> Basis:
    """Returns sign(z) max(|z| - k, 0) with k = 1/4, 1/2 and 3/4, times `factor`.

    Each function is zero below its corner k and linear above it. Beyond -1 and 1, it is constant.
    """
    z = jnp.clip(z, -1.0, 1.0)
    first, second, third = (factor * (z - jnp.clip(z, -k, k)) for k in (0.25, 0.5, 0.75))
    return first, second, third


def even_corners(z: Array, factor: float | Scalar = 1.0) -> Basis:
    """Returns max(|z| - k, 0) with k = 1/4, 1/2 and 3/4, times `factor`, as `odd_corners`."""
    return odd_corners(jnp.abs(z), factor)


def waves(z: Array, factor: float = 1.0) -> Basis:
    """Returns cos(pi z), cos(2 pi z) and cos(3 pi z), times `factor`, for z limited to 0 to 1."""
    z = jnp.pi * jnp.clip(z, 0.0, 1.0)
    return factor * jnp.cos(z), factor * jnp.cos(2.0 * z), factor * jnp.cos(3.0 * z)


def rises(z: Array, width: float, factor: float | Scalar = 1.0) -> Basis:
    """Returns the smooth sign z/(z^2 + w^2)^(1/2), z and (z^2 + w^2)^(1/2), times `factor`.

    w is `width`. Beyond -1 and 1, each function is constant.
    """
    z = jnp.clip(z, -1.0, 1.0)
    size = magnitude(z, width)
    return factor * z / size, factor * z, factor * size


class Powers(eqx.Module):
    """A sum of three functions of a state, each multiplied by a parameter."""

    a: Scalar = parameter(0.0, -20.0, 20.0, "-", WHY_FACTOR)
    """Factor of the first function."""
    b: Scalar = parameter(0.0, -20.0, 20.0, "-", WHY_FACTOR)
    """Factor of the second function."""
    c: Scalar = parameter(0.0, -20.0, 20.0, "-", WHY_FACTOR)
    """Factor of the third function."""

    def total(self, basis: Basis) -> Array:
        """Returns the sum of the basis functions, each multiplied by its parameter."""
        first, second, third = basis
        return self.a * first + self.b * second + self.c * third


class InPart(eqx.Module):
    """A law that acts in one part of the robot."""

    part: ClassVar[str] = "body"
    """Part of the robot: "body", "tail" or "robot", which is both."""

    def cells(self, x: Section) -> Array:
        """Returns 1 in the cells of the part, and 0 in the other cells."""
        if self.part == "robot":
            return jnp.ones_like(x.in_tail)
        return x.in_tail if self.part == "tail" else 1.0 - x.in_tail


class PartPowers(InPart, Powers):
    """A sum of three functions of a state in one part of the robot."""


class ChamberPowers(PartPowers):
    """A sum of three functions of the pressure of the chamber at a cell, in the body."""

    scale: Scalar = shape_parameter(200e3, 1e3, 2e6, "Pa", "the pressures of a soft robot")
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |p|."""

    def state(self, x: Section) -> Array:
        """Returns the pressure [Pa] of the chamber at each cell."""
        return x.pressure

    @abstractmethod
    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the pressure z [Pa]."""

    def of_pressure(self, x: Section) -> Array:
        """Returns the function of the pressure in the body, and 0 in the tail."""
        return self.cells(x) * self.total(self.basis(self.state(x)))


class Drift(eqx.Module):
    """A sum of two functions of the time t of the trial, multiplied by a and b."""

    a: eqx.AbstractVar[Scalar]
    b: eqx.AbstractVar[Scalar]

    @abstractmethod
    def basis(self, z: Array) -> tuple[Array, Array]:
        """Returns the basis functions at the time z."""

    def drift(self, t: Array) -> Array:
        """Returns the sum at the time t."""
        first, second = self.basis(t)
        return self.a * first + self.b * second


SETTLING_TIMES = (0.3, 0.1)
"""Time constants of a drift that settles, divided by the duration of the longest trials."""


class TimeFunction(Powers):
    """A function a q + b (1 - exp(-q/0.3)) + c (1 - exp(-q/0.1)) with q = t/scale.

    t is the time of the trial. The first function is a steady drift, and the others settle. Unlike
    powers of t, they hardly grow after the end of shorter trials.
    """

    scale: Scalar = shape_parameter(2.0, 1e-2, 1e5, "s", "the durations of trials")
    """Time after which the function is constant. A learned function uses the 99.5 % quantile of t.
    """

    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the time z."""
        q = jnp.clip(z / self.scale, 0.0, 1.0)
        slow, fast = (-jnp.expm1(-q / x) for x in SETTLING_TIMES)
        return q, slow, fast

    def at(self, t: Array) -> Array:
        """Returns the function at the time `t` [s]."""
        return self.total(self.basis(t))


class RigDrift(TimeFunction):
    """A drift of the rig."""

    def state(self, x: Readings) -> Array:
        """Returns the time [s]."""
        return x.t


class LocalDrift(InPart, TimeFunction):
    """A drift of a property of the robot."""

    a: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY_DRIFT)
    """a, steady drift."""
    b: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY_DRIFT)
    """b, drift that settles slowly."""
    c: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY_DRIFT)
    """c, drift that settles fast."""

    def state(self, x: Section) -> Array:
        """Returns the time in each cell."""
        return jnp.expand_dims(x.t, -1) + jnp.zeros_like(x.s)

    def in_cells(self, x: Section) -> Array:
        """Returns the drift in the cells of the part, and 0 in the other cells."""
        return self.cells(x) * self.at(self.state(x))


class Sine(eqx.Module):
    """a sin(2 pi f t) + b cos(2 pi f t), with the frequency f."""

    of_gain: ClassVar[bool] = False
    """Whether the sine changes a gain. The frequency is then that of a sine times the readings."""

    a: eqx.AbstractVar[Scalar]
    b: eqx.AbstractVar[Scalar]
    frequency: eqx.AbstractVar[Scalar]

    def state(self, x: Readings) -> Array:
        """Returns the fraction of f t: 0 at the start of a period, 1 at its end."""
        return jnp.mod(self.frequency * x.t, 1.0)

    def basis(self, z: Array) -> tuple[Array, Array]:
        """Returns the sine and the cosine at the phase z."""
        return jnp.sin(2.0 * math.pi * z), jnp.cos(2.0 * math.pi * z)

    def at(self, t: Array) -> Array:
        """Returns the value at the times `t` [s]."""
        sine, cosine = self.basis(self.frequency * t)
        return self.a * sine + self.b * cosine
