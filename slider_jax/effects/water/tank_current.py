"""Water of the tank that drifts."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import WaterMotion, parameter


class TankCurrent(WaterMotion):
    """A steady stream, of pumps, of warmth, or that the robot itself has set going.

        U = (U_x, U_y)

    Source: momentum of a jet, Batchelor, G. K. (1967), An Introduction to Fluid Dynamics,
    Cambridge, ch. 5: a thrust of 0.1 N over 0.03 m by 0.1 m makes one of about 0.2 m/s.
    """

    title = "the tank's water drifts"
    order = 510

    U_x: Scalar = parameter(
        0.0, -0.2, 0.2, "m/s", "the robot's own jet runs at 0.2 m/s and comes back in a small tank"
    )
    """Along x."""
    U_y: Scalar = parameter(0.0, -0.1, 0.1, "m/s", "warmth stirs at some cm/s, pumps at more")
    """Along y."""

    def velocity(self, t):
        zero = jnp.zeros_like(t)
        return zero + self.U_x, zero + self.U_y
