"""Axial friction in a boundary layer that the crossflow makes thinner."""

import equinox as eqx

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter
from slider_jax.effects.functions import magnitude

CROSSFLOW_ROUNDING = 1e-3
"""Crossflow speed [m/s] below which |u_n| is smoothed, so that the derivative is finite."""


class ThinnedFriction(ForceDensity):
    """Laminar friction along a cylinder in oblique flow.

        F_tau = -2.7 c rho (nu H |u_n|)^(1/2) u_tau

    The crossflow makes the boundary layer thinner, so friction increases with the crossflow. nu is
    the kinematic viscosity. |u_n| is smoothed below 1 mm/s. Lighthill and Bone explain the large
    drag of swimming fish by this effect. Source: Taylor, G. (1952), Analysis of the swimming of
    long and narrow animals, Proc. R. Soc. A 214, 158-183, for a circular section (c = 1).
    """

    title = "friction in a thinned boundary layer"
    order = 420
    resists_axially = True

    c: Scalar = parameter(
        0.0, 0.0, 3.0, "-", "1 for a smooth round cylinder, more for a flat section"
    )
    """c, friction divided by Taylor's value."""
    viscosity: Scalar = eqx.field(default=1.0e-6)
    """Kinematic viscosity nu [m^2/s] of the water."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        root = (self.viscosity * x.height * magnitude(x.u_n, CROSSFLOW_ROUNDING)) ** 0.5
        F_tau = -2.7 * self.c * self.density * root * x.u_tau
        return F_tau, 0.0 * F_tau
