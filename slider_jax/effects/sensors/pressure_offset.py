"""Zero error of the pressure sensors."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class PressureOffset(Instrument):
    """The readings of all pressures are too large by the same pressure p_0.

        p_read = p + p_0

    Source: zero drift of a measuring system, Doebelin, E. O. (2003), Measurement Systems, 5th ed.,
    McGraw-Hill, ch. 3.
    """

    title = "zero error of the pressure sensors"
    order = 550
    sensors = ("pressure",)

    offset: Scalar = parameter(0.0, -20e3, 20e3, "Pa", "zero drift of 2 % for a sensor of 1 MPa")
    """p_0, zero error [Pa]."""

    def read(self, true):
        return true._replace(pressures=true.pressures + self.offset)
