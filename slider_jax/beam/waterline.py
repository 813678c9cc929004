"""The surface of the water, and the wet part of each cell.

A cell is a straight piece between two nodes. At the depth d below the surface, the fraction
sigma(d/b) of a section is wet, where b is the thickness of the surface:

    sigma(x) = 1/2 + 3 x/2 - 2 x^3 for |x| < 1/2,    0 above,    1 below
    wet      = mean of sigma over the cell = (S(x_2) - S(x_1))/(x_2 - x_1),    dS/dx = sigma

x_1 and x_2 are d/b at the two nodes. sigma(x) + sigma(-x) = 1, so the wet length of a straight
body that pierces the surface is exact for every b: it equals the length below the surface.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar

NEARLY_LEVEL = 1e-4
"""Difference of d/b between the ends of a cell, below which Simpson's rule replaces the quotient.
The quotient then has an error of 1e-12, its derivative one of 1e-8, and Simpson's rule 1e-9."""


class Immersion(eqx.Module):
    """The wet part of the cells, at the end of a stage."""

    wet: Float[Array, " cells"]
    """Fraction [-] of each cell that is wet."""
    slope: Float[Array, " cells"]
    """Derivative [1/m] of `wet` with respect to the depth."""
    up: Float[Array, "2"]
    """Unit vector (x, y) upwards."""

    def wetting(self, u_n: Array, phi: Array) -> Array:
        """Returns the rate [1/s] at which the motion across the body wets the cells.

        `u_n` [m/s] is the lateral velocity relative to the water, and `phi` [rad] the angle.
        """
        up_n = self.up[1] * jnp.cos(phi) - self.up[0] * jnp.sin(phi)
        return -self.slope * u_n * up_n


class Waterline(eqx.Module):
    """A plane water surface at rest. A stream of the water must be parallel to it."""

    level: Scalar
    """Height [m] of the surface along the upward direction. The head starts at height 0."""
    up: Scalar = 0.0
    """Angle [rad] of the upward direction from the x axis."""
    thickness: Scalar = 0.03
    """b [m], over which a level body dips in: about the width of the body in the plane."""

    def upward(self) -> Float[Array, "2"]:
        """Returns the unit vector (x, y) upwards."""
        up = jnp.asarray(self.up, float)
        return jnp.stack([jnp.cos(up), jnp.sin(up)])

    def depth(self, place: Float[Array, "2 n"]) -> Float[Array, " n"]:
        """Returns the depth [m] of n points (x, y) [m]; it is negative above the surface."""
        return self.level - jnp.tensordot(self.upward(), place, 1)

    def immersion(self, nodes: Float[Array, "2 nodes"]) -> Immersion:
        """Returns the immersion of the cells between `nodes` (x, y) [m]."""
        x = self.depth(nodes) / self.thickness
        a, b = x[:-1], x[1:]
        level = jnp.abs(b - a) < NEARLY_LEVEL
        width = jnp.where(level, 1.0, b - a)
        middle = 0.5 * (a + b)
        mean = (_area(b) - _area(a)) / width
        simpson = (_wet(a) + 4.0 * _wet(middle) + _wet(b)) / 6.0
        slope = jnp.where(level, _slope(middle), (_wet(b) - _wet(a)) / width)
        wet = jnp.where(level, simpson, mean)
        return Immersion(wet, slope / self.thickness, self.upward())


def _wet(x):
    c = jnp.clip(x, -0.5, 0.5)
    return 0.5 + 1.5 * c - 2.0 * c**3


def _slope(x):
    c = jnp.clip(x, -0.5, 0.5)
    return 1.5 - 6.0 * c**2


def _area(x):
    """Returns the integral of `_wet` up to x."""
    c = jnp.clip(x, -0.5, 0.5)
    return 0.09375 + 0.5 * c + 0.75 * c**2 - 0.5 * c**4 + jnp.maximum(x - 0.5, 0.0)
