"""Form drag of the head and its attachments."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter


class HeadDrag(ForceDensity):
    """Pressure drag of a blunt front end, its fitting, or the tubes that it pulls.

        F_tau = -rho A |u_tau| u_tau / 2 delta(s - L)

    A is the drag area, coefficient times frontal area; the force acts in the cell at the head.
    Source: Hoerner, S. F. (1965), Fluid-Dynamic Drag, ch. 3: 0.8 to 1.2 on the frontal area of
    blunt bodies, 0.2 for rounded ones.
    """

    title = "form drag of the head"
    order = 430
    resists_axially = True

    area: Scalar = parameter(
        0.0, 0.0, 3e-3, "m^2", "0.9e-3 for a blunt end of 30 by 30 mm; tubes and fittings add"
    )
    """A, drag coefficient times frontal area."""
    density: Scalar = eqx.field(default=1000.0)
    """rho [kg/m^3]."""

    def force(self, x):
        at_head = jnp.where(x.s == x.s[-1], 1.0 / x.ds, 0.0)
        F_tau = -0.5 * self.density * self.area * jnp.abs(x.u_tau) * x.u_tau * at_head
        return F_tau, jnp.zeros_like(F_tau)
