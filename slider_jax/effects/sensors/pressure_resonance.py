"""Resonance of the air in the tube of a pressure sensor."""

import jax

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, last_sample, parameter, shape_parameter
from slider_jax.effects.functions import resonant, resonant_sample


class PressureResonance(Instrument):
    """The air in the tube and the volume at the sensor are a damped oscillator.

        c (p_read'' + b p_read') + p_read = p

    The natural frequency is 1/(2 pi sqrt(c)). With the damping rate b, the damping ratio is
    b sqrt(c)/2. `PressureSensorLag` is the limit of strong damping. The pressure p, not p_read,
    bends the body. Source: pressure transmission in tubes, Holman, J. P. (2012), Experimental
    Methods for Engineers, 8th ed., McGraw-Hill, ch. 6; time steps as in `ForceResonance`.
    """

    title = "resonance of the pressure sensors' tubes"
    order = 940
    sensors = ("pressure",)

    c: Scalar = parameter(
        0.0, 0.0, 3e-5, "s^2", "3e-5 for 1 m of 3 mm tube and 25 ml at the sensor, which is 29 Hz"
    )
    """c, inverse of the squared natural angular frequency."""
    damping_rate: Scalar = shape_parameter(
        40.0, 4.0, 400.0, "1/s", "damping ratios of 0.01 to 1 for a resonance at 29 Hz"
    )
    """b, damping rate. With the default, the damping ratio is 0.1 for a resonance at 29 Hz."""

    def read(self, true):
        def series(p):
            return resonant(p, true.t, self.c, self.damping_rate)

        return true._replace(pressures=jax.vmap(series)(true.pressures))

    def read_sample(self, true, read):
        def sample(x, y):
            return resonant_sample(x, true.t, self.c, self.damping_rate, y)

        pressures = jax.vmap(sample)(true.pressures, read.pressures)
        return last_sample(true)._replace(pressures=pressures)
