"""A hard limit of the flow."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter
from slider_jax.effects.functions import limited


class RateLimit(Flow):
    """The rate of the pressure follows the lag up to a largest rate R.

        dp/dt = min(max((p_set - p)/k, -R), R)

    The function `limited` smooths the corners. `ChokedFlow` reduces every rate, `RateLimit` only
    rates near or above R. Source: valve saturation, Beater, P. (2007), Pneumatic Drives, Springer.
    """

    title = "the flow has a hard limit"
    order = 100

    inverse: Scalar = parameter(
        0.0, 0.0, 2e-6, "s/Pa", "the largest rate R is at least 0.5 MPa/s", 4e-7
    )
    """1/R. At k = 87 ms, a step from -250 to 250 kPa without this limit causes 6 MPa/s."""

    def rate(self, rate, x):
        return limited(rate, self.inverse)
