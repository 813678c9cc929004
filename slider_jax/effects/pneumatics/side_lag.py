"""Different lags of the left and right chambers."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter


class SideLag(Flow):
    """The left chambers (p > 0) and the right chambers (p < 0) have different time constants.

        dp/dt = (p_set - p)/(k (1 + x))    while p > 0
        dp/dt = (p_set - p)/(k (1 - x))    while p < 0

    p is the pressure of the left chamber minus the pressure of the right chamber. Source: charge of
    a volume through a line, Beater, P. (2007), Pneumatic Drives, Springer.
    """

    title = "left and right chambers have different lags"
    order = 670

    x: Scalar = parameter(
        0.0,
        -0.5,
        0.5,
        "-",
        "valves and hoses of the two sides differ by up to a factor of three",
        physical=(-0.95, 0.95),
    )
    """x, half of the difference of the time constants, divided by their mean k."""

    def rate(self, rate, x):
        return rate / (1.0 + self.x * x.side)
