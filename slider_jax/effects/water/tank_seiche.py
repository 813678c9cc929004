"""Sloshing of the water in the tank."""

import math

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import WaterMotion, parameter, shape_parameter


class TankSeiche(WaterMotion):
    """The lowest standing wave in the tank moves the water along x.

        U_x = a_cos cos(2 pi f t) + a_sin sin(2 pi f t),    (2 pi f)^2 = g k tanh(k h),  k = pi/l

    l is the tank's length, h the water depth and k the wavenumber. The model omits the force of the
    wave's pressure gradient on the body. Source: Lamb, H. (1932), Hydrodynamics, 6th ed., ch. IX.
    """

    title = "the tank's water sloshes"
    order = 530

    a_cos: Scalar = parameter(0.0, -0.02, 0.02, "m/s", "the surface moves by some mm")
    """Amplitude of the cosine in U_x."""
    a_sin: Scalar = parameter(0.0, -0.02, 0.02, "m/s", "the surface moves by some mm")
    """Amplitude of the sine in U_x."""
    frequency: Scalar = shape_parameter(
        0.76, 0.2, 2.0, "Hz", "tanks 0.2 to 3 m long; 0.76 for a tank 1 m long and 0.3 m deep"
    )
    """f, frequency."""

    def velocity(self, t):
        angle = 2.0 * math.pi * self.frequency * t
        U_x = self.a_cos * jnp.cos(angle) + self.a_sin * jnp.sin(angle)
        return U_x, jnp.zeros_like(U_x)
