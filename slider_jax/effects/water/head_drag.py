"""Form drag of the head and its attachments."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.beam.spatial import no_load
from slider_jax.effects.base import ForceDensity, parameter


class HeadDrag(ForceDensity):
    """Pressure drag of a blunt front end, of fittings at the head, or of the tubes.

        F_tau = -rho A |u_tau| u_tau / 2 delta(s - L)

    A is the drag coefficient times the frontal area. The drag coefficient is 0.8 to 1.2 for blunt
    bodies and 0.2 for rounded bodies. The force acts in the cell at the head.
    Source: Hoerner, S. F. (1965), Fluid-Dynamic Drag, ch. 3.
    """

    title = "form drag of the head"
    order = 430
    resists_axially = True

    area: Scalar = parameter(
        0.0, 0.0, 3e-3, "m^2", "0.9e-3 for a blunt end of (30 mm)^2, more with tubes and fittings"
    )
    """A, drag coefficient times frontal area."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        F_tau = self._along(x.u_tau, x.s, x.ds)
        return F_tau, jnp.zeros_like(F_tau)

    def load_in_space(self, x):
        F_tau, zero = self._along(x.u.tau, x.structure.s, x.structure.ds), no_load(x)
        return zero._replace(force=zero.force._replace(tau=F_tau))

    def _along(self, u_tau, s, ds):
        at_head = jnp.where(s == s[-1], 1.0 / ds, 0.0)
        return -0.5 * self.density * self.area * jnp.abs(u_tau) * u_tau * at_head
