"""Wrong clock of the valves' controller."""

from slider_jax.actuation.waveform import Stretched
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter


class DriveClock(Command):
    """The clock of the valves' controller is slow, so all strides are too long.

        p_set,valve(t) = p_set((1 - slow) t)

    The clocks of all sensors are right. Source: frequency error of an oscillator, IEEE Std
    1139-2008, Definitions of Physical Quantities for Fundamental Frequency and Time Metrology.
    """

    title = "slow clock of the valves' controller"
    order = 35

    slow: Scalar = parameter(
        0.0, -0.03, 0.03, "-",
        "a ceramic resonator is wrong by 0.5 %, an RC oscillator by 1 to 3 %",
    )  # fmt: skip
    """Relative error of the controller's clock. A negative value means that the clock is fast."""

    def command(self, wave, rear):
        return Stretched(wave, self.slow)
