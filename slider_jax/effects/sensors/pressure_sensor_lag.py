"""Lag of the pressure sensors."""

import jax

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, last_sample, parameter
from slider_jax.effects.functions import lagged, lagged_sample


class PressureSensorLag(Instrument):
    """A tube or the electronics of a sensor acts as a first-order low-pass filter.

        tau dp_read/dt = p - p_read

    The solution is exact if p is linear between samples. The pressure p, not p_read, bends the
    body. Source: first-order instruments, Doebelin, E. O. (2003), Measurement Systems, 5th ed.,
    McGraw-Hill, ch. 3.
    """

    title = "lag of the pressure sensors"
    order = 570
    sensors = ("pressure",)

    tau: Scalar = parameter(
        0.0, 0.0, 0.05, "s", "thin tubes and noise filters have time constants of tens of ms"
    )
    """tau, time constant of the filter [s]."""

    def read(self, true):
        pressures = jax.vmap(lambda p: lagged(p, true.t, self.tau))(true.pressures)
        return true._replace(pressures=pressures)

    def read_sample(self, true, read):
        def sample(p, y):
            return lagged_sample(p, true.t, self.tau, y)

        pressures = jax.vmap(sample)(true.pressures, read.pressures)
        return last_sample(true)._replace(pressures=pressures)
