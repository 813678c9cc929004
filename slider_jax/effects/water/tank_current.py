"""A steady current in the tank."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import WaterMotion, parameter


class TankCurrent(WaterMotion):
    """A steady current from pumps, convection or the robot's own jet.

        U = (U_x, U_y)

    A thrust of 0.1 N on an area of 0.03 m by 0.1 m causes a jet of about 0.2 m/s. Source: momentum
    of a jet, Batchelor, G. K. (1967), An Introduction to Fluid Dynamics, Cambridge, ch. 5.
    """

    title = "the tank has a steady current"
    order = 510

    U_x: Scalar = parameter(
        0.0, -0.2, 0.2, "m/s", "a jet of 0.2 m/s from the robot recirculates in a small tank"
    )
    """U_x, velocity along x."""
    U_y: Scalar = parameter(0.0, -0.1, 0.1, "m/s", "some cm/s by convection, more by pumps")
    """U_y, velocity along y."""

    def velocity(self, t):
        zero = jnp.zeros_like(t)
        return zero + self.U_x, zero + self.U_y
