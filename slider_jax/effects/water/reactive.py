"""Lighthill's reactive force of the added mass (LAEBT)."""

import math

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.beam.spatial import SpatialLoad, Vec
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

    In space, the section is an ellipse of the height H and the width W; W = 0 is a plate. Its added
    masses are m_n = m_A and m_b = m_a pi rho W^2/4, and its added moment of inertia about tau is
    J_A = m_a pi rho (H^2 - W^2)^2/128. With P = m_n u_n n + m_b u_b b, the roll w relative to the
    water (`SpatialSection.slip`), the energy E = (m_n u_n^2 + m_b u_b^2 + J_A w^2)/2 per length and
    c_r = -d(J_A w)/dt + d(u_tau J_A w)/ds, force and couple are

        f = -dP/dt + d(u_tau P - E tau)/ds + (J_A w dw/ds - c_r Omega_tau) tau
        c = (c_r + (m_n - m_b) u_n u_b) tau                                   (Munk's moment)

    A section that moves through the water's surface at the lateral velocity u_n changes the wet
    fraction w of its slice of water at the rate r = dw/dt - u_tau dw/ds = u_n n . grad(w). On
    entry, the water gains the momentum m_A u_n suddenly. On exit, the water keeps its momentum:

        F = w f - m_A max(r, 0) u_n n

    The body then loses the power m_A |r| u_n^2/2 in both directions, to the spray on entry and to
    the water that stays behind on exit, so the surface never gives energy to the body.

    If H is uniform, dm_A/ds = 0. `HeadAddedMass` adds the point force at a blunt
    head; docs/explanation/decisions.md explains why the base model omits this force.

    Source: Lighthill, M. J. (1971), Large-amplitude elongated-body theory of fish locomotion, Proc.
    R. Soc. B 179, 125-138; the equations for F_a of the paper in `slider_jax.paper`. Nonuniform
    water: Candelier, F., Porez, M. and Boyer, F. (2013), Note on the swimming of an elongated body
    in a non-uniform flow, J. Fluid Mech. 716, 616-637. In space: Candelier, F., Boyer, F. and
    Leroyer, A. (2011), Three-dimensional extension of Lighthill's large-amplitude elongated-body
    theory of fish locomotion, J. Fluid Mech. 674, 196-226. Entry: von Karman, T. (1929), The impact
    on seaplane floats during landing, NACA Technical Note 321. Exit: Kaplan, P. (1987), Analysis
    and prediction of flat bottom slamming impact of advanced marine vehicles in waves, Int.
    Shipbuild. Progr. 34, 44-53.
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

    def entrained_mass(self, x):
        return self.added_mass(x.height)

    def load_in_space(self, x):
        s, u, w = x.structure, x.u, x.slip
        unit = self.m_a * math.pi * self.density
        m_n, m_b = unit * s.height**2 / 4.0, unit * s.width**2 / 4.0
        m_n_s, m_b_s = unit * s.height * s.height_s / 2.0, unit * s.width * s.width_s / 2.0
        difference = s.height**2 - s.width**2
        J = unit * difference**2 / 128.0
        J_s = unit * difference * (s.height * s.height_s - s.width * s.width_s) / 32.0
        zero = jnp.zeros_like(w)
        P = Vec(zero, m_n * u.n, m_b * u.b)
        P_t = Vec(zero, m_n * x.u_t.n, m_b * x.u_t.b).plus(x.omega.cross(P))
        E = 0.5 * (m_n * u.n**2 + m_b * u.b**2 + J * w**2)
        E_s = m_n * u.n * x.u_s.n + m_b * u.b * x.u_s.b + J * w * x.slip_s
        E_s = E_s + 0.5 * (m_n_s * u.n**2 + m_b_s * u.b**2 + J_s * w**2)
        flux = Vec(-E, u.tau * P.n, u.tau * P.b)
        flux_s = Vec(
            -E_s,
            x.u_s.tau * P.n + u.tau * (m_n * x.u_s.n + m_n_s * u.n),
            x.u_s.tau * P.b + u.tau * (m_b * x.u_s.b + m_b_s * u.b),
        ).plus(x.curvature.cross(flux))
        H_s = J * x.slip_s + J_s * w
        c_r = -J * x.slip_t + x.u_s.tau * J * w + u.tau * H_s
        along = J * w * x.slip_s - c_r * x.curvature.tau
        force = flux_s.minus(P_t)
        couple = c_r + (m_n - m_b) * u.n * u.b
        return SpatialLoad(Vec(force.tau + along, force.n, force.b), Vec(couple, zero, zero))
