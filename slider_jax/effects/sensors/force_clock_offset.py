"""Forces and pressures that are recorded with two clocks."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter
from slider_jax.effects.functions import delayed


class ForceClockOffset(Instrument):
    """The time stamps of the forces are later than the time stamps of the pressures.

        F_read(t) = F(t - delay)

    Forces between samples are interpolated with cubic polynomials. Source: dead-time elements,
    Doebelin, E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill, ch. 3.
    """

    title = "clock offset of the force sensor"
    order = 630
    sensors = ("thrust", "recoil")

    delay: Scalar = parameter(
        0.0, -0.03, 0.03, "s", "two recorders that start separately are tens of ms apart"
    )
    """Delay of the time stamps [s]. A negative delay means that the time stamps are early."""

    def read(self, true):
        return true._replace(
            thrust=delayed(true.thrust, true.t, self.delay),
            recoil=delayed(true.recoil, true.t, self.delay),
        )
