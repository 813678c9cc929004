"""A different drag coefficient on the tail."""

import equinox as eqx

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter
from slider_jax.effects.water.drag import NormalDrag


class TailDrag(ForceDensity):
    """Crossflow drag from the difference in drag coefficient between tail and body.

        F_n = -rho C H |u_n| u_n / 2   on the tail

    The tail is a sheet with sharp edges and has larger strokes than the body. A negative C means
    less drag than the body's coefficient gives. Source: as `NormalDrag`; Hoerner, S. F. (1965),
    Fluid-Dynamic Drag, ch. 3, on edges.
    """

    title = "the tail has a different drag"
    order = 460

    C: Scalar = parameter(
        0.0, -2.0, 3.0, "-", "plates and round bodies differ by 1 in steady flow, more in strokes"
    )
    """Drag coefficient of the tail minus that of the body."""
    density: Scalar = eqx.field(default=1000.0)
    """rho [kg/m^3]."""

    def force(self, x):
        F_tau, F_n = NormalDrag(self.C, self.density).force(x)
        return x.in_tail * F_tau, x.in_tail * F_n
