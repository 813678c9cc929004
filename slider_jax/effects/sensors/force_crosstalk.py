"""A force sensor that is turned against the robot."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class ForceCrosstalk(Instrument):
    """The sensor's axes are turned by an angle a, counted as phi is, against the clamp's.

        thrust_read = cos a thrust + sin a recoil
        recoil_read = cos a recoil - sin a thrust

    Source: rotation of axes; cross-sensitivity of a multi-component balance, Doebelin, E. O.
    (2003), Measurement Systems, 5th ed., McGraw-Hill, ch. 5.
    """

    title = "force sensor turned against the robot"
    order = 600
    sensors = ("thrust", "recoil")

    angle: Scalar = parameter(0.0, -0.1, 0.1, "rad", "mounted by eye: within some 5 degrees")
    """a [rad]."""

    def read(self, true):
        cos, sin = jnp.cos(self.angle), jnp.sin(self.angle)
        return true._replace(
            thrust=cos * true.thrust + sin * true.recoil,
            recoil=cos * true.recoil - sin * true.thrust,
        )
