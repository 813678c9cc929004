"""Drag with a coefficient that decreases with the stroke amplitude."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.equations import Section
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter, shape_parameter


def squared_KC(x: Section, f: Scalar) -> Array:
    """Returns KC^2 of each cell for the frequency `f` [Hz]. `KeuleganCarpenterDrag` defines KC."""
    U_2 = x.u_n**2 + (x.u_n_t / (2.0 * math.pi * f)) ** 2
    return U_2 / (f * x.height) ** 2


class KeuleganCarpenterDrag(ForceDensity):
    """Drag of a plate that oscillates at the frequency f, in addition to the base model's drag.

        F_n = -rho C KC^(-e) H |u_n| u_n / 2
        KC  = U/(f H),    U^2 = u_n^2 + (du_n/dt)^2/(2 pi f)^2

    KC is the Keulegan-Carpenter number. If u_n is sinusoidal, U is its amplitude. A smooth limit
    keeps KC above KC_min. Source: Keulegan, G. H. and Carpenter, L. H. (1958), Forces on cylinders
    and plates in an oscillating fluid, J. Res. Natl. Bur. Stand. 60, 423-440. For a plate, e = 1/3
    and C = 8 are from Graham, J. M. R. (1980), The forces on sharp-edged cylinders in oscillatory
    flow at low Keulegan-Carpenter numbers, J. Fluid Mech. 97, 331-346.
    """

    title = "drag coefficient that decreases with amplitude"
    order = 500

    C: Scalar = parameter(
        0.0, 0.0, 10.0, "-", "8 for a plate with sharp edges; smaller for round edges or large C_d"
    )
    """C, drag coefficient at KC = 1."""
    exponent: Scalar = shape_parameter(
        1.0 / 3.0, 0.05, 0.7, "-", "1/3 for a plate; smaller for a section with blunt edges"
    )
    """e, exponent of the decrease."""
    KC_min: Scalar = shape_parameter(
        0.3, 0.05, 3.0, "-", "KC = 0.3 is an amplitude of H/20; for thick edges, KC_min is larger"
    )
    """KC_min, smallest KC. This limit keeps the drag coefficient finite."""
    stride_frequency: Scalar = eqx.field(default=5.0)
    """Drive frequency f [Hz] of the trial."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        KC_2 = squared_KC(x, self.stride_frequency) + self.KC_min**2
        C_d = self.C * KC_2 ** (-0.5 * self.exponent)
        F_n = -0.5 * self.density * C_d * x.height * jnp.abs(x.u_n) * x.u_n
        return jnp.zeros_like(F_n), F_n
