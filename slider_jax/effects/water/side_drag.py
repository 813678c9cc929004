"""Drag that differs between motion to the left and to the right."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter


class SideDrag(ForceDensity):
    """The drag coefficient of the crossflow depends on the direction of the motion.

        F_n = -rho C H u_n^2/2

    With a positive C, the drag is larger while the body moves along n (u_n > 0), and smaller while
    it moves back. The mean of both directions is unchanged. Source: drag coefficients of sections
    without symmetry, Hoerner, S. F. (1965), Fluid-Dynamic Drag, ch. 3.
    """

    title = "the drag is larger in motion to one side"
    order = 820

    C: Scalar = parameter(
        0.0, -1.0, 1.0, "-", "a half-tube has C_d = 2.3 and 1.2; hoses on one side act similarly"
    )
    """C, half of the difference of the drag coefficients of both directions."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        F_n = -0.5 * self.density * self.C * x.height * x.u_n**2
        return jnp.zeros_like(F_n), F_n
