"""Axial friction under a boundary layer that the crossflow thins."""

import equinox as eqx

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter
from slider_jax.effects.functions import magnitude

CROSSFLOW_ROUNDING = 1e-3
"""Crossflow [m/s] below which the root is rounded, so that its derivative stays finite."""


class ThinnedFriction(ForceDensity):
    """Laminar friction along a cylinder in oblique flow.

        F_tau = -2.7 c rho (nu H |u_n|)^(1/2) u_tau

    The crossflow removes the boundary layer, so friction increases with the crossflow. Lighthill
    and Bone explain the large drag of swimming fish by this thinning. |u_n| is rounded below 1
    mm/s. Source: Taylor, G. (1952), Analysis of the swimming of long and narrow animals, Proc. R.
    Soc. A 214, 158-183, for a circular section (c = 1).
    """

    title = "friction under a thinned boundary layer"
    order = 420
    resists_axially = True

    c: Scalar = parameter(
        0.0, 0.0, 3.0, "-", "1 for a smooth round cylinder; a flat section has more surface"
    )
    """Ratio of the friction to Taylor's value."""
    viscosity: Scalar = eqx.field(default=1.0e-6)
    """nu [m^2/s]."""
    density: Scalar = eqx.field(default=1000.0)
    """rho [kg/m^3]."""

    def force(self, x):
        root = (self.viscosity * x.height * magnitude(x.u_n, CROSSFLOW_ROUNDING)) ** 0.5
        F_tau = -2.7 * self.c * self.density * root * x.u_tau
        return F_tau, 0.0 * F_tau
