"""Zero error of the regulator."""

from slider_jax.actuation.waveform import Shaped
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter


class RegulatorOffset(Command):
    """The set pressure at the valves of all chambers is too large by the constant p_0.

        p_set,valve = p_set + p_0

    With a positive p_0, the side of positive pressure reaches a higher pressure than the opposite
    side. The sensors measure the actual pressure, so the measured p changes too. Source: zero
    drift, Doebelin, E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill, ch. 3.
    """

    title = "zero error of the regulator"
    order = 30

    offset: Scalar = parameter(0.0, -20e3, 20e3, "Pa", "zero error of 2 % for a regulator of 1 MPa")
    """p_0, zero error of the regulator."""

    def curve(self, p_set):
        """Returns the set pressure at the valves [Pa]."""
        return p_set + self.offset

    def command(self, wave, rear):
        return Shaped(wave, self.curve)
