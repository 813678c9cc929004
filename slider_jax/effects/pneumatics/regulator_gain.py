"""A regulator whose span is off."""

from slider_jax.actuation.waveform import Shaped
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter


class RegulatorGain(Command):
    """The valves work towards a set pressure that is too large by a factor.

        p_set,valve = (1 + g) p_set

    The sensors read what the chambers have, so p follows. Source: static sensitivity, Doebelin,
    E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill, ch. 3.
    """

    title = "gain of the regulator"
    order = 20
    sensors = ("pressure", "thrust", "recoil", "tip")

    gain: Scalar = parameter(
        0.0, -0.2, 0.2, "-", "analogue regulators are good to a few percent, worse under flow"
    )
    """g, relative error of the span."""

    def curve(self, p_set):
        """What reaches the valves [Pa]."""
        return (1.0 + self.gain) * p_set

    def command(self, wave, chamber):
        return Shaped(wave, self.curve)
