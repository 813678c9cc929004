"""Different gains of the two axes of the force sensor."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class ForceGainMismatch(Instrument):
    """The two axes of the force sensor have different gains. The mean gain is unchanged.

        thrust_read = (1 + d) thrust,    recoil_read = (1 - d) recoil

    Source: static sensitivity of a multi-component balance, Doebelin, E. O. (2003), Measurement
    Systems, 5th ed., McGraw-Hill, ch. 5.
    """

    title = "the axes of the force sensor have different gains"
    order = 900
    sensors = ("thrust", "recoil")

    difference: Scalar = parameter(
        0.0, -0.15, 0.15, "-", "each axis is calibrated alone, often with a load in air"
    )
    """d, half of the difference of the gains (thrust minus recoil)."""

    def read(self, true):
        d = self.difference
        return true._replace(thrust=(1.0 + d) * true.thrust, recoil=(1.0 - d) * true.recoil)
