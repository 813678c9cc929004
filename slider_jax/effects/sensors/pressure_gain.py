"""Gain error of the pressure sensors."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class PressureGain(Instrument):
    """The readings of all pressures are too large by the same factor.

        p_read = (1 + g) p

    Source: static sensitivity of a measuring system, Doebelin, E. O. (2003), Measurement Systems,
    5th ed., McGraw-Hill, ch. 3.
    """

    title = "gain error of the pressure sensors"
    order = 540
    sensors = ("pressure",)

    gain: Scalar = parameter(
        0.0, -0.1, 0.1, "-", "sensors and supply voltages have an error of a few percent"
    )
    """g, relative error of the sensitivity."""

    def read(self, true):
        return true._replace(pressures=(1.0 + self.gain) * true.pressures)
