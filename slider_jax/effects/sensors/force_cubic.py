"""Nonlinearity of the force sensor."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class ForceCubic(Instrument):
    """The sensitivity of the force sensor changes with the force.

        thrust_read = thrust (1 + c thrust^2),    recoil_read = recoil (1 + c recoil^2)

    The error is odd, because positive and negative forces deform the sensor symmetrically. Source:
    nonlinearity of a measuring system, Doebelin, E. O. (2003), Measurement Systems, 5th ed.,
    McGraw-Hill, ch. 3.
    """

    title = "nonlinearity of the force sensor"
    order = 910
    sensors = ("thrust", "recoil")

    c: Scalar = parameter(
        0.0, -0.1, 0.1, "1/N^2", "10 % at 1 N for an overloaded or home-made sensor"
    )
    """c, relative change of the sensitivity per squared force."""

    def read(self, true):
        return true._replace(
            thrust=true.thrust * (1.0 + self.c * true.thrust**2),
            recoil=true.recoil * (1.0 + self.c * true.recoil**2),
        )
