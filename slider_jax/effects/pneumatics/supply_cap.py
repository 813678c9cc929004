"""A supply pressure below the set pressure."""

from slider_jax.actuation.waveform import Shaped
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter
from slider_jax.effects.functions import limited


class SupplyCap(Command):
    """The regulator delivers the set pressure up to the supply pressure P.

        p_set,valve = min(max(p_set, -P), P)

    The function `limited` smooths the corners. `SupplyLimit` reduces every set pressure, but
    `SupplyCap` reduces only set pressures near P or above P. Source: Andersen, B. W. (1967), The
    analysis and design of pneumatic systems, Wiley.
    """

    title = "the supply caps the set pressure"
    order = 50

    inverse: Scalar = parameter(
        0.0, 0.0, 8e-6, "1/Pa", "compressors of such rigs supply 125 kPa or more", 3.5e-6
    )
    """1/P, inverse of the supply pressure."""

    def curve(self, p_set):
        """Returns the set pressure at the valves [Pa]."""
        return limited(p_set, self.inverse)

    def command(self, wave, rear):
        return Shaped(wave, self.curve)
