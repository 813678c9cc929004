"""Added-mass force at a blunt head, where the added mass begins."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter
from slider_jax.effects.water.reactive import ReactiveForce


class HeadAddedMass(ForceDensity):
    """Point force of the added mass at the head, as at the leading edge of a slender wing.

        F_n   = -m_A u_tau u_n delta(s - L)
        F_tau =  m_A u_n^2/2 delta(s - L)
        m_A   =  m_a pi rho H^2/4

    The water ahead of the body has no lateral momentum and gains momentum suddenly at a blunt head.
    The force is the sum of the momentum fluxes of `ReactiveForce` at the head. The force is zero if
    the head is clamped in still water (u_n = 0). The force acts in the cell at the head. Source:
    Lighthill, M. J. (1971), as in `ReactiveForce`; Jones, R. T. (1946), Properties of
    low-aspect-ratio pointed wings at speeds below and above the speed of sound, NACA Report 835.
    """

    title = "added mass that begins at the head"
    order = 440
    is_candidate = False

    m_a: Scalar = parameter(
        0.0, 0.0, 1.5, "-", "as large as m_a of the body, or smaller if the flow separates"
    )
    """m_a, added-mass coefficient at the head."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        at_head = jnp.where(x.s == x.s[-1], 1.0 / x.ds, 0.0)
        m_A = ReactiveForce(self.m_a, self.density).added_mass(x.height) * at_head
        return m_A * x.u_n**2 / 2.0, -m_A * x.u_tau * x.u_n
