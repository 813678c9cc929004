"""A regulator whose zero is off."""

from slider_jax.actuation.waveform import Shaped
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter


class RegulatorOffset(Command):
    """The valves of both chambers work towards a set pressure that is too large by an amount.

        p_set,valve = p_set + p_0

    The side of positive pressure then fills further than the other. The sensors read what the
    chambers have, so p follows. Source: zero drift, Doebelin, E. O. (2003), Measurement Systems,
    5th ed., McGraw-Hill, ch. 3.
    """

    title = "zero of the regulator"
    order = 30
    sensors = ("pressure", "thrust", "recoil", "tip")

    offset: Scalar = parameter(
        0.0, -20e3, 20e3, "Pa", "zero error of 2 % of a regulator for 1 MPa, of either side's"
    )
    """p_0."""

    def curve(self, p_set):
        """What reaches the valves [Pa]."""
        return p_set + self.offset

    def command(self, wave, chamber):
        return Shaped(wave, self.curve)
