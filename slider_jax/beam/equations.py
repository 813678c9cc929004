"""The planar beam in one cell: geometry, constitutive laws, balance of momentum and moment.

With kappa = d(phi)/ds, omega = d(phi)/dt and the strain eps, in the paper's notation,

    d(eps)/dt           = dV_tau/ds - kappa V_n                                   (stretch)
    (1 + eps) omega     = dV_n/ds + kappa V_tau                                   (turn)
    M                   = EI (kappa + alpha d(kappa)/dt) + M_extra - M_act        (moment law)
    m (dV_tau/dt - omega V_n) = dT/ds - kappa N + (1 + eps) F_tau                 (along tau)
    m (dV_n/dt + omega V_tau) = dN/ds + kappa T + (1 + eps) F_n                   (along n)
    0                   = dM/ds + (1 + eps) N                                     (moment)

M_extra being what the model's effects add, and T = EA (eps + alpha d(eps)/dt), which is solved for
eps in each cell, so eps is no unknown.

A time derivative is always (value - reference)/dt: every stage of a scheme has this form.
"""

import equinox as eqx
from jaxtyping import Array, Float

from slider_jax.beam.state import Fields, to_body


class Structure(eqx.Module):
    """Cell values of the structure, each of shape (cells,)."""

    linear_density: Array
    EI: Array
    EA: Array
    damping_time: Array
    height: Array
    height_s: Array
    """dH/ds, where the height varies along the body."""
    s: Array
    ds: Array
    in_tail: Array
    """1 in the cells of the tail, 0 in those of the body."""
    joint: Array
    """A unit at the joint, spread over the cells beside it [1/m]."""


class Reference(eqx.Module):
    """What (value - reference)/dt subtracts, at mid-cells, and the dt [s] that divides."""

    V_tau: Array
    V_n: Array
    phi: Array
    kappa: Array
    strain: Array
    internal: tuple[Array, ...]
    dt: Array


class Section(eqx.Module):
    """A short piece of body as an effect sees it; every entry has the shape of a cell array.

    Velocities [m/s] in the body frame, `u` relative to the water; `_s` is d/ds, `_t` is d/dt.
    `in_tail` and `joint` as in `Structure`.
    """

    t: Array
    s: Array
    ds: Array
    in_tail: Array
    joint: Array
    height: Array
    height_s: Array
    linear_density: Array
    EI: Array
    phi: Array
    pressure: Array
    """Of the chamber at the cell, what bends the body [Pa]."""
    kappa: Array
    kappa_t: Array
    omega: Array
    strain: Array
    strain_t: Array
    V_tau: Array
    V_n: Array
    V_tau_t: Array
    V_n_t: Array
    u_tau: Array
    u_n: Array
    u_tau_s: Array
    u_n_s: Array
    u_tau_t: Array
    u_n_t: Array


def strain(T, structure: Structure, reference: Reference):
    """eps from T = EA (eps + alpha (eps - eps_ref)/dt)."""
    lag = structure.damping_time / reference.dt
    return (T / structure.EA + lag * reference.strain) / (1.0 + lag)


def section(
    mid: Fields, slope: Fields, structure: Structure, reference: Reference, water, pressure, t
) -> Section:
    """The kinematics of a cell; `water`: velocity [m/s] and acceleration [m/s^2] of the water,
    each (x, y), uniform over the body; `pressure` [Pa] of the chambers in the cells."""
    dt = reference.dt
    omega = (mid.phi - reference.phi) / dt
    V_tau_t = (mid.V_tau - reference.V_tau) / dt
    V_n_t = (mid.V_n - reference.V_n) / dt
    eps = strain(mid.T, structure, reference)
    U_tau, U_n = to_body(water[0], mid.phi)
    A_tau, A_n = to_body(water[1], mid.phi)
    return Section(
        t=t,
        s=structure.s,
        ds=structure.ds,
        in_tail=structure.in_tail,
        joint=structure.joint,
        height=structure.height,
        height_s=structure.height_s,
        linear_density=structure.linear_density,
        EI=structure.EI,
        phi=mid.phi,
        pressure=pressure,
        kappa=slope.phi,
        kappa_t=(slope.phi - reference.kappa) / dt,
        omega=omega,
        strain=eps,
        strain_t=(eps - reference.strain) / dt,
        V_tau=mid.V_tau,
        V_n=mid.V_n,
        V_tau_t=V_tau_t,
        V_n_t=V_n_t,
        u_tau=mid.V_tau - U_tau,
        u_n=mid.V_n - U_n,
        u_tau_s=slope.V_tau - slope.phi * U_n,
        u_n_s=slope.V_n + slope.phi * U_tau,
        u_tau_t=V_tau_t - omega * U_n - A_tau,
        u_n_t=V_n_t + omega * U_tau - A_n,
    )


def equations(
    mid: Fields,
    slope: Fields,
    x: Section,
    structure: Structure,
    force: tuple[Array, Array],
    moment: Array,
) -> tuple[Float[Array, " cells"], ...]:
    """The six rows of a cell, in the order of the module's docstring; zero when satisfied.

    `force`: (F_tau, F_n); `moment`: M_extra - M_act.
    """
    F_tau, F_n = force
    m, stretch = structure.linear_density, 1.0 + x.strain
    elastic = structure.EI * (x.kappa + structure.damping_time * x.kappa_t)
    return (
        x.strain_t - slope.V_tau + x.kappa * mid.V_n,
        stretch * x.omega - slope.V_n - x.kappa * mid.V_tau,
        mid.M - elastic - moment,
        m * (x.V_tau_t - x.omega * mid.V_n) - slope.T + x.kappa * mid.N - stretch * F_tau,
        m * (x.V_n_t + x.omega * mid.V_tau) - slope.N - x.kappa * mid.T - stretch * F_n,
        slope.M + stretch * mid.N,
    )
