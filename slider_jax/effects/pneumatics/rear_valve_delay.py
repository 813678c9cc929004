"""Dead time of the rear chamber's valve beyond that of the front's."""

from slider_jax.actuation.waveform import Delayed
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter


class RearValveDelay(Command):
    """The rear chamber's valve follows its command later than the front chamber's.

        p_set,valve(t) = p_set(t - delay) in the rear chamber

    One-sided: a command that starts at t = 0 cannot come earlier. Source: solenoid valves'
    switching times, Beater, P. (2007), Pneumatic Drives, Springer, ch. 5.
    """

    title = "the rear valve acts later than the front valve"
    order = 60
    rear_only = True
    sensors = ("pressure", "thrust", "recoil", "tip")

    delay: Scalar = parameter(
        0.0, 0.0, 0.03, "s", "one valve of a pair may take its whole switching time longer"
    )
    """Dead time beyond that of the front chamber."""

    def command(self, wave, chamber):
        return Delayed(wave, self.delay) if chamber == 1 else wave
