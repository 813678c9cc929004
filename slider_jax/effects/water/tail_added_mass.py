"""A different added mass on the tail."""

import equinox as eqx

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter
from slider_jax.effects.water.reactive import ReactiveForce


class TailAddedMass(ForceDensity):
    """Reactive force due to the difference in added mass between tail and body.

    The terms of `ReactiveForce` act along the tail. At the joint, the added mass changes suddenly,
    which causes a point force, similar to the lift at the leading edge of a slender wing:

        F_n   = -m_A u_tau u_n delta(s - s_joint)
        F_tau =  m_A u_n^2/2 delta(s - s_joint)
        m_A   =  m_a pi rho H^2/4

    Source: Lighthill, M. J. (1971), as in `ReactiveForce`; Jones, R. T. (1946), Properties of
    low-aspect-ratio pointed wings at speeds below and above the speed of sound, NACA Report 835.
    """

    title = "the tail has a different added mass"
    order = 470

    m_a: Scalar = parameter(
        0.0, -0.5, 0.8, "-", "m_a of a sheet is 1, or less if the flow separates; the body is thick"
    )
    """m_a, added-mass coefficient of the tail minus the coefficient of the body."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        reactive = ReactiveForce(self.m_a, self.density)
        F_tau, F_n = reactive.force(x)
        at_joint = reactive.added_mass(x.height) * x.joint
        return (
            x.in_tail * F_tau + at_joint * x.u_n**2 / 2.0,
            x.in_tail * F_n - at_joint * x.u_tau * x.u_n,
        )

    def entrained_mass(self, x):
        return x.in_tail * ReactiveForce(self.m_a, self.density).added_mass(x.height)
