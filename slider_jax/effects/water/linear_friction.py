"""Axial friction proportional to the speed."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter


class LinearFriction(ForceDensity):
    """Viscous friction of the axial flow, proportional to the axial speed.

        F_tau = -c u_tau

    To first order, c is pi mu D (pi f/nu)^(1/2) for a cylinder of diameter D that oscillates
    axially at the frequency f. mu and nu are the dynamic and the kinematic viscosity of the water.
    `TangentialFriction` is quadratic in the speed. Source: Stokes, G. G. (1851), On the effect of
    the internal friction of fluids on the motion of pendulums, Trans. Camb. Phil. Soc. 9, 8-106.
    """

    title = "axial friction linear in the speed"
    order = 810
    resists_axially = True

    c: Scalar = parameter(
        0.0, 0.0, 3.0, "N s/m^2", "0.4 for D = 30 mm and f = 5 Hz; tubes and a guide add friction"
    )
    """c, friction per length and speed."""

    def force(self, x):
        F_tau = -self.c * x.u_tau
        return F_tau, jnp.zeros_like(F_tau)
