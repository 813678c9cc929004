"""A supply whose pressure is lower than what is asked of it."""

from slider_jax.actuation.waveform import Shaped
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter
from slider_jax.effects.functions import limited


class SupplyCap(Command):
    """The regulator gives what is asked, up to the pressure of the supply.

        p_set,valve = min(max(p_set, -P), P)

    Its corners are rounded by `limited`. `SupplyLimit` droops from the beginning; this one not
    before its limit. Source: Andersen, B. W. (1967), The analysis and design of pneumatic systems,
    Wiley.
    """

    title = "the supply caps the set pressure"
    order = 50
    sensors = ("pressure", "thrust", "recoil", "tip")

    inverse: Scalar = parameter(
        0.0, 0.0, 8e-6, "1/Pa", "compressors of such rigs hold 125 kPa or more", 3.5e-6
    )
    """1/P."""

    def curve(self, p_set):
        """What reaches the valves [Pa]."""
        return limited(p_set, self.inverse)

    def command(self, wave, chamber):
        return Shaped(wave, self.curve)
