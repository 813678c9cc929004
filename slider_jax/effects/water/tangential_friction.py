"""Skin friction along the body."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.beam.spatial import no_load
from slider_jax.effects.base import ForceDensity, parameter


class TangentialFriction(ForceDensity):
    """Quadratic friction of the flow along both sides of the body.

        F_tau = -rho C_t (2 H) |u_tau| u_tau / 2

    Source: Taylor, G. (1952), Analysis of the swimming of long and narrow animals, Proc. R. Soc. A
    214, 158-183.
    """

    title = "friction along the skin"
    order = 410
    resists_axially = True

    C_t: Scalar = parameter(
        0.0, 0.0, 0.2, "-", "0.005 for a smooth plate, more with tubes, seams or a clamp"
    )
    """C_t, friction coefficient. The wetted area per length of a flat body is 2 H."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        F_tau = self._along(x.u_tau, x.height)
        return F_tau, jnp.zeros_like(F_tau)

    def load_in_space(self, x):
        zero = no_load(x)
        return zero._replace(force=zero.force._replace(tau=self._along(x.u.tau, x.height)))

    def _along(self, u_tau, height):
        return -self.density * self.C_t * height * jnp.abs(u_tau) * u_tau
