"""Terms of the motion of the water."""

import math
from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Curve, Readings, WaterMotion, parameter, shape_parameter

WHY = "the water moves more slowly than the tail"


class WaterSine(WaterMotion):
    """A component of the water's velocity is a sin(2 pi f t) + b cos(2 pi f t)."""

    a: Scalar = parameter(0.0, -0.5, 0.5, "m/s", WHY)
    """a, amplitude of the sine."""
    b: Scalar = parameter(0.0, -0.5, 0.5, "m/s", WHY)
    """b, amplitude of the cosine."""
    frequency: Scalar = shape_parameter(2.0, 0.1, 500.0, "Hz", "usual sample rates resolve these")
    """f, frequency of the largest sine in the residual."""

    @abstractmethod
    def velocity(self, t: Array) -> tuple[Array, Array]: ...

    def state(self, x: Readings) -> Array:
        """Returns the fraction of f t: 0 at the start of a period, 1 at its end."""
        return jnp.mod(self.frequency * x.t, 1.0)

    def basis(self, z: Array) -> tuple[Array, Array]:
        """Returns the basis functions at the phase z."""
        return jnp.sin(2.0 * math.pi * z), jnp.cos(2.0 * math.pi * z)

    def speed(self, t: Array) -> Array:
        """Returns the component of the velocity [m/s] at `t` [s]."""
        a, b = self.basis(self.frequency * t)
        return self.a * a + self.b * b


class WaterSineAlong(WaterSine):
    """The water oscillates along x, the axis of the tank."""

    title = "water that oscillates along the tank"
    term_curve = Curve("phase, the fraction of f t", "-", "velocity U_x", "m/s")

    def velocity(self, t):
        return self.speed(t), jnp.zeros_like(t)


class WaterSineAcross(WaterSine):
    """The water oscillates along y, across the tank."""

    title = "water that oscillates across the tank"
    term_curve = Curve("phase, the fraction of f t", "-", "velocity U_y", "m/s")

    def velocity(self, t):
        return jnp.zeros_like(t), self.speed(t)
