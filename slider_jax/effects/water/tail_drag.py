"""A different drag coefficient on the tail."""

import equinox as eqx

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter
from slider_jax.effects.water.drag import NormalDrag


class TailDrag(ForceDensity):
    """Crossflow drag due to the difference in drag coefficient between tail and body.

        F_n = -rho C H |u_n| u_n / 2   on the tail

    The tail is a sheet with sharp edges and moves farther than the body. With a negative C,
    the tail has a smaller coefficient than the body. Source: as in `NormalDrag`; Hoerner, S. F.
    (1965), Fluid-Dynamic Drag, ch. 3, on edges.
    """

    title = "the tail has a different drag"
    order = 460

    C: Scalar = parameter(
        0.0, -2.0, 3.0, "-", "plate and cylinder differ by 1 in steady flow, more in oscillation"
    )
    """C, drag coefficient of the tail minus the coefficient of the body."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        F_tau, F_n = NormalDrag(self.C, self.density).force(x)
        return x.in_tail * F_tau, x.in_tail * F_n
