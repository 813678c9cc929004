"""Another drag coefficient on the tail."""

import equinox as eqx

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter
from slider_jax.effects.water.drag import NormalDrag


class TailDrag(ForceDensity):
    """Drag of the crossflow on the tail beyond that of the whole body.

        F_n = -rho C H |u_n| u_n / 2   on the tail

    The tail is a sheet with sharp edges and moves farther than the body; C below zero is less drag
    than the body's. Source: as `NormalDrag`; Hoerner, S. F. (1965), Fluid-Dynamic Drag, ch. 3, on
    edges.
    """

    title = "another drag on the tail"
    order = 460

    C: Scalar = parameter(
        0.0, -2.0, 3.0, "-", "plates and round bodies differ by 1 in steady flow, more in strokes"
    )
    """Drag coefficient of the tail less that of the body."""
    density: Scalar = eqx.field(default=1000.0)
    """rho [kg/m^3]."""

    def force(self, x):
        F_tau, F_n = NormalDrag(self.C, self.density).force(x)
        return x.in_tail * F_tau, x.in_tail * F_n
