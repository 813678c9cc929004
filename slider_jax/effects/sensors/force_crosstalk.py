"""A force sensor rotated relative to the robot."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class ForceCrosstalk(Instrument):
    """The sensor's axes are rotated from the clamp's axes by an angle a in the direction of phi.

        thrust_read = cos a thrust + sin a recoil
        recoil_read = cos a recoil - sin a thrust

    Source: rotation of axes; cross-sensitivity of a multi-component balance, Doebelin, E. O.
    (2003), Measurement Systems, 5th ed., McGraw-Hill, ch. 5.
    """

    title = "force sensor rotated relative to the robot"
    order = 600
    sensors = ("thrust", "recoil")

    angle: Scalar = parameter(0.0, -0.1, 0.1, "rad", "mounting by eye has 5 degrees of error")
    """Angle a [rad]."""

    def read(self, true):
        cos, sin = jnp.cos(self.angle), jnp.sin(self.angle)
        return true._replace(
            thrust=cos * true.thrust + sin * true.recoil,
            recoil=cos * true.recoil - sin * true.thrust,
        )
