"""Force and pressure recorded on two clocks."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter
from slider_jax.effects.functions import delayed


class ForceClockOffset(Instrument):
    """The force samples carry time stamps that are late against those of the pressure.

        F_read(t) = F(t - delay)

    Cubic between samples. Source: dead-time elements, Doebelin, E. O. (2003), Measurement Systems,
    5th ed., McGraw-Hill, ch. 3.
    """

    title = "clock of the force sensor is off"
    order = 630
    sensors = ("thrust", "recoil")

    delay: Scalar = parameter(
        0.0, -0.03, 0.03, "s", "two recorders started by hand or by software: tens of ms"
    )
    """By how much the stamps are late, negative where early [s]."""

    def read(self, true):
        return true._replace(
            thrust=delayed(true.thrust, true.t, self.delay),
            recoil=delayed(true.recoil, true.t, self.delay),
        )
