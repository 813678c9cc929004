"""Drag proportional to the crossflow."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter


class LinearDrag(ForceDensity):
    """Viscous drag of the crossflow, dominant if the amplitude is too small for separation.

        F_n = -c u_n

    To first order, c is 2 pi^(3/2) mu (D^2 f/nu)^(1/2) for a cylinder of diameter D that oscillates
    at the frequency f. mu and nu are the dynamic and the kinematic viscosity of the water.
    Source: Stokes, G. G. (1851), On the effect of the internal friction of fluids on the motion of
    pendulums, Trans. Camb. Phil. Soc. 9, 8-106.
    """

    title = "drag linear in the crossflow"
    order = 450

    c: Scalar = parameter(
        0.0, 0.0, 5.0, "N s/m^2", "0.7 for D = 30 mm and f = 5 Hz; waves and tubes add drag"
    )
    """c, drag per length and speed."""

    def force(self, x):
        F_n = -self.c * x.u_n
        return jnp.zeros_like(F_n), F_n
