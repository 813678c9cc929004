"""Dead time of the valves."""

from slider_jax.actuation.waveform import Delayed
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter


class ValveDelay(Command):
    """The valves follow the command after a dead time.

        p_set,valve(t) = p_set(t - delay)

    Source: solenoid valves' switching times, Beater, P. (2007), Pneumatic Drives, Springer, ch. 5.
    """

    title = "dead time of the valves"
    order = 10

    delay: Scalar = parameter(
        0.0, 0.0, 0.06, "s", "5 to 30 ms of switching time and the controller's cycle time"
    )
    """Dead time of all valves."""

    def command(self, wave, rear):
        return Delayed(wave, self.delay)
