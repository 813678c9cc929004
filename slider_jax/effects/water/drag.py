"""Quadratic drag of the crossflow."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter


class NormalDrag(ForceDensity):
    """Drag of the flow across the body. The flow separates from the body.

        F_n = -rho C_d H |u_n| u_n / 2

    H is the height of the robot and u_n the lateral velocity relative to the water. Source: Taylor,
    G. (1952), Analysis of the swimming of long and narrow animals, Proc. R. Soc. A 214, 158-183;
    the equation for F_d of the paper in `slider_jax.paper`.
    """

    title = "drag of the crossflow"
    in_every_model = True

    C_d: Scalar = parameter(
        0.0, 0.0, 6.0, "-", "2 for a plate in steady flow, more for small stroke amplitudes"
    )
    """C_d, drag coefficient."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        F_n = -0.5 * self.density * self.C_d * x.height * jnp.abs(x.u_n) * x.u_n
        return jnp.zeros_like(F_n), F_n
