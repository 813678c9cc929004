"""Quadratic drag of the crossflow."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.beam.spatial import SpatialLoad, Vec
from slider_jax.effects.base import ForceDensity, parameter


class NormalDrag(ForceDensity):
    """Drag of the flow across the body. The flow separates from the body.

        F_n = -rho C_d H |u_n| u_n / 2

    In space, the width W of the section resists motion along b, and a plate resists roll. The roll
    w is relative to the water:

        F_b = -rho C_d W |u_b| u_b / 2,    C_tau = -rho C_d H^4 |w| w / 64

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

    def load_in_space(self, x):
        s, unit = x.structure, 0.5 * self.density * self.C_d
        zero, w = jnp.zeros_like(x.u.n), x.slip
        F_n = -unit * s.height * jnp.abs(x.u.n) * x.u.n
        F_b = -unit * s.width * jnp.abs(x.u.b) * x.u.b
        couple = -unit / 32.0 * s.height**4 * jnp.abs(w) * w
        return SpatialLoad(Vec(zero, F_n, F_b), Vec(couple, zero, zero))
