"""Gain error of the regulator."""

from slider_jax.actuation.waveform import Shaped
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter


class RegulatorGain(Command):
    """The set pressure at the valves is too large by the factor 1 + g.

        p_set,valve = (1 + g) p_set

    The sensors measure the actual pressure, so the measured p changes too. Source: static
    sensitivity, Doebelin, E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill, ch. 3.
    """

    title = "gain error of the regulator"
    order = 20

    gain: Scalar = parameter(
        0.0, -0.2, 0.2, "-", "analogue regulators have a few percent error, and more under flow"
    )
    """g, relative error of the gain."""

    def curve(self, p_set):
        """Returns the set pressure at the valves [Pa]."""
        return (1.0 + self.gain) * p_set

    def command(self, wave, rear):
        return Shaped(wave, self.curve)
