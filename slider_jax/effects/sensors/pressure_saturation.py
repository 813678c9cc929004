"""Pressure sensors beyond their range."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter, shape_parameter
from slider_jax.effects.functions import magnitude

CORNER = 5e3
"""Width [Pa] of the smooth corner at the end of the range."""


class PressureSaturation(Instrument):
    """A pressure sensor loses sensitivity beyond its range of +-P.

        p_read = p - c sign(p) max(|p| - P, 0)

    With c = 1, the reading stays at P. The corner is smooth. Source: Doebelin, E. O. (2003),
    Measurement Systems, 5th ed., McGraw-Hill, ch. 3.
    """

    title = "pressure sensors beyond their range"
    order = 980
    sensors = ("pressure",)

    c: Scalar = parameter(
        0.0, 0.0, 1.0, "-", "1 for a reading that stays at P", physical=(0.0, 1.0)
    )
    """c, relative loss of the sensitivity beyond the range."""
    P: Scalar = shape_parameter(
        100e3, 20e3, 400e3, "Pa", "the ranges of common pressure sensors of such rigs"
    )
    """P, end of the range."""

    def read(self, true):
        p = true.pressures
        excess = 0.5 * (magnitude(p - self.P, CORNER) - magnitude(p + self.P, CORNER))
        return true._replace(pressures=p - self.c * (p + excess))
