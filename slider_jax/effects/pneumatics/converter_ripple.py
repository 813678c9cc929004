"""Error of the converter whose reading the regulator of a chamber controls."""

import math

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter, shape_parameter

WHY = "two codes (steps) of the converter, 0.93 kPa each"


class ConverterRipple(Flow):
    """The regulator controls the reading p of a converter with a periodic error.

        dp/dt = (1 + df/dp) q
        f(p)  = a sin(2 pi p/P) + b cos(2 pi p/P) + c sin(pi p/P) + d cos(pi p/P)

    f is the error of the reading p, and q is the rate of the true pressure. Terms of second order
    in df/dp are neglected. The errors of two neighbouring bits have the periods P and 2 P.
    `PressureRipple` is an error that the regulator does not see. Source: integral nonlinearity of
    converters, IEEE Std 1241-2010.
    """

    title = "periodic error of the reading in the pressure control"
    order = 186

    a: Scalar = parameter(0.0, -2e3, 2e3, "Pa", WHY)
    """a, amplitude of the sine with the period P."""
    b: Scalar = parameter(0.0, -2e3, 2e3, "Pa", WHY)
    """b, amplitude of the cosine with the period P."""
    c: Scalar = parameter(0.0, -2e3, 2e3, "Pa", WHY)
    """c, amplitude of the sine with the period 2 P."""
    d: Scalar = parameter(0.0, -2e3, 2e3, "Pa", WHY)
    """d, amplitude of the cosine with the period 2 P."""
    period: Scalar = shape_parameter(
        32 * 932.8, 8 * 932.8, 128 * 932.8, "Pa", "8 to 128 codes, for the third to the seventh bit"
    )
    """P, period of the lower bit. The default is 32 codes."""

    def rate(self, rate, x):
        turn = 2.0 * math.pi / self.period
        low, high = turn * x.p, 0.5 * turn * x.p
        slope = turn * (self.a * jnp.cos(low) - self.b * jnp.sin(low))
        slope += 0.5 * turn * (self.c * jnp.cos(high) - self.d * jnp.sin(high))
        return (1.0 + slope) * rate
