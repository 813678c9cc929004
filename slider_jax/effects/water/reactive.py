"""Lighthill's reactive force of the added mass (LAEBT)."""

import math

import equinox as eqx

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter


class ReactiveForce(ForceDensity):
    """Force per length f of the large-amplitude elongated-body theory, with all three terms.

    f = -[ d(m_A u_n n)/dt - d(m_A u_tau u_n n)/ds + d(m_A u_n^2/2 tau)/ds ], with
    d(tau)/ds = kappa n, d(n)/ds = -kappa tau, d(n)/dt = -omega tau:

        F_n   = -m_A ( du_n/dt - d(u_tau u_n)/ds + u_n^2 kappa/2 ) + dm_A/ds u_tau u_n
        F_tau = -m_A ( -u_n omega + u_tau u_n kappa + u_n du_n/ds ) - dm_A/ds u_n^2/2
        m_A   = m_a pi rho H^2/4

    In nonuniform water (`WaterField`), u is relative to the water at the place of the section, and
    the velocity gradient of the water turns and stretches the impulse m_A u_n n:

        f = f(u) - m_A u_n grad(U_n)

    With this term, a body of uniform height has no tangential force, because the pressure acts
    normal to a strip. For a straight strip, the force is that of potential flow:
    F_n = -m_A (dV_n/dt - n . (dU/dt + U_tau dU/dtau + V_n dU/dn)). The flow must change little over
    the height H. The force omits the pressure gradient of the accelerating water on the displaced
    volume (Froude-Krylov force rho A DU/Dt, with the cross-section A), also in uniform water.

    If H is uniform, dm_A/ds = 0. `HeadAddedMass` adds the point force at a blunt
    head; docs/explanation/decisions.md explains why the base model omits this force.

    Source: Lighthill, M. J. (1971), Large-amplitude elongated-body theory of fish locomotion, Proc.
    R. Soc. B 179, 125-138; the equations for F_a of the paper in `slider_jax.paper`. Nonuniform
    water: Candelier, F., Porez, M. and Boyer, F. (2013), Note on the swimming of an elongated body
    in a non-uniform flow, J. Fluid Mech. 716, 616-637.
    """

    title = "reactive force of the added mass"
    in_every_model = True

    m_a: Scalar = parameter(
        0.0, 0.0, 1.5, "-", "1 for a thin plate in potential flow, less if the flow separates"
    )
    """m_a, added-mass coefficient."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def added_mass(self, height):
        """Returns m_A [kg/m] of a section of `height` [m]."""
        return self.m_a * math.pi * self.density * height**2 / 4.0

    def force(self, x):
        m_A = self.added_mass(x.height)
        m_A_s = self.m_a * math.pi * self.density * x.height * x.height_s / 2.0
        flux_s = x.u_tau_s * x.u_n + x.u_tau * x.u_n_s
        F_n = -m_A * (x.u_n_t - flux_s + x.u_n**2 * x.kappa / 2.0)
        F_tau = -m_A * (-x.u_n * x.omega + x.u_tau * x.u_n * x.kappa + x.u_n * x.u_n_s)
        if x.U_n_gradient is not None:
            refraction = m_A * x.u_n * x.U_n_gradient
            F_tau, F_n = F_tau - refraction[0], F_n - refraction[1]
        return F_tau - m_A_s * x.u_n**2 / 2.0, F_n + m_A_s * x.u_tau * x.u_n
