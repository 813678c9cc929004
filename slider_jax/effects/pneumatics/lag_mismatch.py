"""Different time constants of the chambers."""

import math

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter


class LagMismatch(Flow):
    """The last chamber has a different time constant, for example because of a longer hose.

        dp/dt = (p_set - p)/(k (1 + x r))

    r is 0 at the first and 1 at the last chamber, and evenly spaced between. Source:
    charge of a volume through a line, Beater, P. (2007), Pneumatic Drives, Springer.
    """

    title = "the last chamber has another lag than the first chamber"
    order = 80
    rear_only = True

    x: Scalar = parameter(
        0.0,
        -0.5,
        1.0,
        "-",
        "hoses and volumes of the chambers differ by up to a factor of two",
        physical=(-0.95, math.inf),
    )
    """x, relative difference of the last chamber's time constant from the first chamber's k."""

    def rate(self, rate, x):
        return rate / (1.0 + self.x * x.rear)
