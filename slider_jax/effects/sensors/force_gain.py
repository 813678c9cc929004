"""Gain error of the force sensor."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class ForceGain(Instrument):
    """The readings of thrust and recoil are too large by the same factor.

        thrust_read = (1 + g) thrust,    recoil_read = (1 + g) recoil

    Source: static sensitivity of a measuring system, Doebelin, E. O. (2003), Measurement Systems,
    5th ed., McGraw-Hill, ch. 3.
    """

    title = "gain error of the force sensor"
    order = 580
    sensors = ("thrust", "recoil")

    gain: Scalar = parameter(
        0.0, -0.15, 0.15, "-", "a calibrated sensor drifts by a few percent; the mount adds errors"
    )
    """g, relative error of the sensitivity."""

    def read(self, true):
        g = self.gain
        return true._replace(thrust=(1.0 + g) * true.thrust, recoil=(1.0 + g) * true.recoil)
