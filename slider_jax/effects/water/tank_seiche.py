"""Water of the tank that sloshes."""

import math

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import WaterMotion, parameter


class TankSeiche(WaterMotion):
    """The tank's lowest standing wave, along x.

        U_x = a_cos cos(2 pi f t) + a_sin sin(2 pi f t),    (2 pi f)^2 = g k tanh(k h),  k = pi/l

    for a tank of length l and depth h. Its pressure on the displaced water is left out.
    Source: Lamb, H. (1932), Hydrodynamics, 6th ed., ch. IX.
    """

    title = "the tank's water sloshes"
    order = 530

    a_cos: Scalar = parameter(0.0, -0.02, 0.02, "m/s", "the surface is seen to move by some mm")
    """At t = 0."""
    a_sin: Scalar = parameter(0.0, -0.02, 0.02, "m/s", "the surface is seen to move by some mm")
    """A quarter of a period later."""
    frequency: Scalar = eqx.field(default=0.76)
    """f [Hz]; the default is of a tank 1 m long and 0.3 m deep."""

    def velocity(self, t):
        angle = 2.0 * math.pi * self.frequency * t
        U_x = self.a_cos * jnp.cos(angle) + self.a_sin * jnp.sin(angle)
        return U_x, jnp.zeros_like(U_x)
