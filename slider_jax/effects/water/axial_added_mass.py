"""Added mass along the body axis."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter


class AxialAddedMass(ForceDensity):
    """Inertia of the water that follows the axial motion of the body.

        F_tau = -m_t (du_tau/dt - omega u_n)

    u is the velocity relative to the water and omega the turning rate. For a slender ellipsoid,
    this added mass is a few per cent of the displaced mass. Source: Newman, J. N. (1977), Marine
    Hydrodynamics, MIT Press, ch. 4.
    """

    title = "added mass along the axis"
    order = 480

    m_t: Scalar = parameter(
        0.0, 0.0, 0.3, "kg/m", "0.03 for a smooth body of 0.7 kg/m, more with tubes and seams"
    )
    """m_t, added mass per length."""

    def force(self, x):
        F_tau = -self.m_t * (x.u_tau_t - x.omega * x.u_n)
        return F_tau, jnp.zeros_like(F_tau)
