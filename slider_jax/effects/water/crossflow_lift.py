"""Lift of the body in oblique flow."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter
from slider_jax.effects.functions import magnitude

AXIAL_ROUNDING = 1e-3
"""Axial speed [m/s] below which |u_tau| is smoothed, so that the derivative is continuous."""


class CrossflowLift(ForceDensity):
    """Quasi-steady lift of each section, due to vortices that separate at an oblique body.

        F_n = -rho C H |u_tau| u_n/2

    The force resists the crossflow and increases with the axial speed, for example with the tow
    speed. |u_tau| is smoothed below 1 mm/s. Source: Hoerner, S. F. and Borst, H. V. (1985),
    Fluid-Dynamic Lift, on slender bodies.
    """

    title = "lift of the body in oblique flow"
    order = 830

    C: Scalar = parameter(
        0.0, 0.0, 3.0, "-", "2 pi for a wing section, below 1 for a slender body without vortices"
    )
    """C, lift coefficient per angle of the oblique flow, on the area H per length."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        F_n = -0.5 * self.density * self.C * x.height * magnitude(x.u_tau, AXIAL_ROUNDING) * x.u_n
        return jnp.zeros_like(F_n), F_n
