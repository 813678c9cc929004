"""Added mass that changes with the stroke amplitude."""

import math

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter
from slider_jax.effects.water.keulegan_carpenter_drag import squared_KC

KC_ROUNDING = 0.1
"""KC below which KC is smoothed, so that its derivative is finite."""


class AmplitudeAddedMass(ForceDensity):
    """The added-mass coefficient changes linearly with the Keulegan-Carpenter number KC.

        F_n = -c KC rho pi H^2/4 du_n/dt
        KC  = U/(f H),    U^2 = u_n^2 + (du_n/dt)^2/(2 pi f)^2

    U is the amplitude of a sinusoidal u_n of the frequency f. KC is smoothed below 0.1. Source:
    Keulegan, G. H. and Carpenter, L. H. (1958), Forces on cylinders and plates in an oscillating
    fluid, J. Res. Natl. Bur. Stand. 60, 423-440.
    """

    title = "added mass that changes with amplitude"
    order = 850

    c: Scalar = parameter(
        0.0, -0.05, 0.3, "-", "up to KC = 10, m_a of plates rises to 2 to 4; of cylinders, it falls"
    )
    """c, change of the added-mass coefficient per KC."""
    stride_frequency: Scalar = eqx.field(default=5.0)
    """Drive frequency f [Hz] of the trial."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        F_n = -self.entrained_mass(x) * x.u_n_t
        return jnp.zeros_like(F_n), F_n

    def entrained_mass(self, x):
        KC = jnp.sqrt(squared_KC(x, self.stride_frequency) + KC_ROUNDING**2)
        return self.c * KC * math.pi * self.density * x.height**2 / 4.0
