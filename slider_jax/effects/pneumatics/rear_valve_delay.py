"""Additional dead time of the last chamber's valve."""

from slider_jax.actuation.waveform import Delayed
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter


class RearValveDelay(Command):
    """The last chamber's valve reacts later than the first chamber's valve.

        p_set,valve(t) = p_set(t - delay r)

    r is 0 at the first and 1 at the last chamber, and evenly spaced between. The delay cannot be
    negative, because the command starts at t = 0. Source: solenoid valves' switching times, Beater,
    P. (2007), Pneumatic Drives, Springer, ch. 5.
    """

    title = "the last chamber's valve acts later than the first chamber's"
    order = 60
    rear_only = True

    delay: Scalar = parameter(
        0.0, 0.0, 0.03, "s", "the delay is at most the switching time of the valve"
    )
    """Dead time of the last valve minus the dead time of the first valve."""

    def command(self, wave, rear):
        return Delayed(wave, self.delay * rear)
