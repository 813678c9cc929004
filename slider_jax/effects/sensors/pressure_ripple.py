"""Periodic error of the analogue-to-digital converter of the pressures."""

import math

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter, shape_parameter


class PressureRipple(Instrument):
    """The error of the converter is periodic in the pressure, because one bit has a wrong weight.

        p_read = p + a sin(2 pi p/P) + b cos(2 pi p/P)

    Source: integral nonlinearity of converters, IEEE Std 1241-2010.
    """

    title = "periodic error of the pressure converter"
    order = 560
    sensors = ("pressure",)

    a: Scalar = parameter(0.0, -6e3, 6e3, "Pa", "six codes (steps) of the converter, 0.93 kPa each")
    """a, amplitude of the sine."""
    b: Scalar = parameter(0.0, -6e3, 6e3, "Pa", "six codes (steps) of the converter, 0.93 kPa each")
    """b, amplitude of the cosine."""
    period: Scalar = shape_parameter(
        32 * 932.8, 8 * 932.8, 128 * 932.8, "Pa", "8 to 128 codes, for the third to the seventh bit"
    )
    """P, period of the error. The default is 32 codes, for the fifth bit of the converter."""

    def read(self, true):
        angle = 2.0 * math.pi * true.pressures / self.period
        ripple = self.a * jnp.sin(angle) + self.b * jnp.cos(angle)
        return true._replace(pressures=true.pressures + ripple)
