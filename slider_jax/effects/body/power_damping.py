"""Damping that is a power of the bending rate."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter, shape_parameter
from slider_jax.effects.functions import magnitude

TYPICAL_RATE = 100.0
"""r_0 [1/(m s)], bending rate d(kappa)/dt in a typical stride."""
RATE_ROUNDING = 10.0
"""w [1/(m s)], width of the smoothing of |d(kappa)/dt|: 10 % of the typical rate. With a smaller w,
Newton's method fails for an exponent below 0.5, because the law is too steep at the rate zero."""


class PowerDamping(BendingMoment):
    """The damping moment of body and tail is a power of the bending rate r = d(kappa)/dt.

        M = EI (kappa + c (|r|/r_0)^(n-1) r/r_0),    r_0 = 100 1/(m s)

    n = 1 is the viscous law of `MaterialDamping`, and a small n is similar to dry friction. |r| is
    smoothed below 10 1/(m s). Source: power laws of damping, Lazan, B. J. (1968), Damping of
    Materials and Members in Structural Mechanics, Pergamon.
    """

    title = "the damping is a power of the bending rate"
    order = 740
    segments = ("body", "tail")

    c: Scalar = parameter(0.0, 0.0, 0.3, "1/m", "a loss factor of 0.1 at a curvature of 3 1/m")
    """c, damping moment at the rate r_0, divided by EI."""
    exponent: Scalar = shape_parameter(
        0.5, 0.3, 2.0, "-", "rubber with fillers has 0.3 to 0.5, water in folds has up to 2"
    )
    """n, exponent of the rate."""

    def moment(self, x, memory, dt):
        size = magnitude(x.kappa_t, RATE_ROUNDING) / TYPICAL_RATE
        power = size ** (self.exponent - 1.0) * x.kappa_t / TYPICAL_RATE
        return self.c * x.EI * power, memory
