"""Chambers that leak."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter


class Leakage(Flow):
    """Air escapes from the chambers at a rate proportional to the pressure.

        dp/dt = (p_set - p)/k - q p

    The pressure approaches p_set/(1 + q k) at the rate 1/k + q. Source: laminar leak of a volume,
    Andersen, B. W. (1967), The analysis and design of pneumatic systems, Wiley.
    """

    title = "leakage of the chambers"
    order = 130

    leak: Scalar = parameter(
        0.0, 0.0, 3.0, "1/s", "intact chambers hold pressure for minutes, torn chambers for 0.3 s"
    )
    """q, inverse of the time constant of the pressure in a closed chamber."""

    def rate(self, rate, x):
        return rate - self.leak * x.p
