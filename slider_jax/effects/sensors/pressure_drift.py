"""Drift of the pressure sensors."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class PressureDrift(Instrument):
    """The zeros of all pressure sensors drift linearly with the time t since the trial's start.

        p_read = p + r t

    The sensors have the same drift, because they share a supply voltage and a board. Source: zero
    drift of a measuring system, Doebelin, E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill,
    ch. 3.
    """

    title = "drift of the pressure sensors"
    order = 930
    sensors = ("pressure",)

    rate: Scalar = parameter(
        0.0, -2e3, 2e3, "Pa/s", "a sensor of 1 MPa drifts by 1 kPa/K; valves warm it by up to 2 K/s"
    )
    """r, drift of the zeros."""

    def read(self, true):
        return true._replace(pressures=true.pressures + self.rate * true.t)
