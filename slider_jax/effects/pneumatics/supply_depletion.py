"""A supply that loses pressure during a trial."""

from slider_jax.actuation.waveform import Fading
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter


class SupplyDepletion(Command):
    """The supply tank empties, so the delivered set pressure decreases with the time t.

        p_set,valve(t) = p_set(t) exp(-r t)

    t is the time since the start of the trial. The pressure of a tank decreases exponentially if
    the outflow is proportional to the pressure. Source: blowdown of a tank, Andersen, B. W. (1967),
    The analysis and design of pneumatic systems, Wiley.
    """

    title = "the supply tank empties"
    order = 660

    rate: Scalar = parameter(
        0.0, 0.0, 0.1, "1/s", "chambers of 0.1 l at 5 Hz and 250 kPa empty a tank of 10 l in 12 s"
    )
    """r, relative loss of pressure per time."""

    def command(self, wave, rear):
        return Fading(wave, self.rate)
