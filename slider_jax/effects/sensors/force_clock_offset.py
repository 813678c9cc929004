"""Force and pressure recorded on two clocks."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter
from slider_jax.effects.functions import delayed


class ForceClockOffset(Instrument):
    """The time stamps of the forces are late relative to those of the pressures.

        F_read(t) = F(t - delay)

    The interpolation between samples is cubic. Source: dead-time elements, Doebelin, E. O. (2003),
    Measurement Systems, 5th ed., McGraw-Hill, ch. 3.
    """

    title = "clock offset of the force sensor"
    order = 630
    sensors = ("thrust", "recoil")

    delay: Scalar = parameter(
        0.0, -0.03, 0.03, "s", "two recorders start tens of ms apart, by hand or by software"
    )
    """Delay of the time stamps [s]. It is negative if the time stamps are early."""

    def read(self, true):
        return true._replace(
            thrust=delayed(true.thrust, true.t, self.delay),
            recoil=delayed(true.recoil, true.t, self.delay),
        )
