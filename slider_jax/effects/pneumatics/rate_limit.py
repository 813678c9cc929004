"""A hard limit of the flow."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter
from slider_jax.effects.functions import limited


class RateLimit(Flow):
    """The rate is that of the lag up to a largest rate.

        dp/dt = min(max((p_set - p)/k, -R), R)

    `limited` rounds the corners. `ChokedFlow` reduces every rate; this effect acts only near its
    limit. Source: saturation of a valve, Beater, P. (2007), Pneumatic
    Drives, Springer.
    """

    title = "the flow has a hard limit"
    order = 100

    inverse: Scalar = parameter(
        0.0, 0.0, 2e-6, "s/Pa", "6 MPa/s reverse 250 kPa at k = 87 ms; R is 0.5 MPa/s or more", 4e-7
    )
    """1/R, the inverse of the largest rate."""

    def rate(self, rate, x):
        return limited(rate, self.inverse)
