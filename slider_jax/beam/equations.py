"""The equations of a planar beam in one cell: geometry, moment law, balances of force and moment.

kappa is d(phi)/ds and omega is d(phi)/dt. docs/reference/glossary.md defines the other symbols.

    d(eps)/dt           = dV_tau/ds - kappa V_n                                   (stretch)
    (1 + eps) omega     = dV_n/ds + kappa V_tau                                   (turn)
    M                   = EI (kappa + alpha d(kappa)/dt) + M_extra - M_act        (moment law)
    m (dV_tau/dt - omega V_n) = dT/ds - kappa N + (1 + eps) F_tau                 (along tau)
    m (dV_n/dt + omega V_tau) = dN/ds + kappa T + (1 + eps) F_n                   (along n)
    0                   = dM/ds + (1 + eps) N                                     (moment)

M_extra is the sum of the moments that the model's effects add. The axial law
T = EA (eps + alpha d(eps)/dt) is solved for eps in each cell, so eps is not an unknown.

A time derivative is (value - reference)/dt. `Reference` contains the reference values and dt.
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.state import Fields, to_body, to_plane
from slider_jax.beam.waterline import Immersion


class Structure(eqx.Module):
    """Properties of the robot in the cells, in SI units; each array has the shape (cells,)."""

    linear_density: Array
    EI: Array
    EA: Array
    damping_time: Array
    height: Array
    height_s: Array
    """dH/ds [-], the slope of the height along the body."""
    s: Array
    ds: Array
    in_tail: Array
    """1 in the cells of the tail, 0 in the cells of the body."""
    joint: Array
    """Unit delta at the joint [1/m], distributed to the two adjacent cells."""
    area: Array | None = None
    """Volume of displaced water per length [m^2]; None without buoyancy."""


class Reference(eqx.Module):
    """Reference values in the cells, and dt [s]. A time derivative is (value - reference)/dt.

    `internal` contains the state of each effect that has a state in the cells.
    """

    V_tau: Array
    V_n: Array
    phi: Array
    kappa: Array
    strain: Array
    internal: tuple[Array, ...]
    dt: Array
    lag: Array
    """damping_time/dt [-]. It is stored because the compiler would divide again in each tangent."""


class LocalWater(eqx.Module):
    """Nonuniform water at the cells; vectors are (x, y)."""

    velocity: Float[Array, "2 cells"]
    """Velocity U [m/s]."""
    rate: Float[Array, "2 cells"]
    """dU/dt [m/s^2] at a fixed place."""
    gradient: Float[Array, "2 2 cells"]
    """dU_i/dx_j [1/s]."""


class Section(eqx.Module):
    """The local state of the body that an effect reads; every entry has shape (cells,).

    Velocities [m/s] are in the body frame: V relative to the tank, u relative to the water. The
    suffix `_s` is d/ds and `_t` is d/dt. The fields up to `joint` and `area` are the fields of
    `Structure`.
    """

    linear_density: Array
    EI: Array
    EA: Array
    damping_time: Array
    height: Array
    height_s: Array
    s: Array
    ds: Array
    in_tail: Array
    joint: Array
    t: Array
    phi: Array
    pressure: Array
    """Pressure [Pa] with which the chamber at the cell bends the body."""
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
    area: Array | None = None
    U_n_gradient: Array | None = None
    """Slopes (2, cells) [1/s] of the water velocity U_n along tau and n; None in uniform water."""
    wet: Array | None = None
    """Fraction [-] of the cell below the water's surface; None without a waterline."""
    wetting: Array | None = None
    """Rate [1/s] at which motion across the body wets the cell; None without a waterline."""


def strain(T, structure: Structure, reference: Reference):
    """Returns the strain eps [-] that solves T = EA (eps + damping_time (eps - eps_ref)/dt)."""
    lag = reference.lag
    return (T / structure.EA + lag * reference.strain) / (1.0 + lag)


def section(
    mid: Fields,
    slope: Fields,
    structure: Structure,
    reference: Reference,
    water: Float[Array, "2 2"] | LocalWater | None,
    pressure,
    t,
    immersion: Immersion | None = None,
) -> Section:
    """Returns the local state of the body in each cell at time `t` [s].

    `mid` and `slope` are the means and slopes d/ds of the unknowns. `pressure` (cells,) [Pa] is the
    pressure of the chamber at each cell. `water` contains the velocity U [m/s] and the acceleration
    [m/s^2] of uniform water, each (x, y), or it is the `LocalWater` at the cells, or None for still
    water. `immersion` is None without a waterline.
    """
    dt = reference.dt
    omega = (mid.phi - reference.phi) / dt
    V_tau_t = (mid.V_tau - reference.V_tau) / dt
    V_n_t = (mid.V_n - reference.V_n) / dt
    eps = strain(mid.T, structure, reference)
    x = Section(
        **vars(structure),
        t=t,
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
        u_tau=mid.V_tau,
        u_n=mid.V_n,
        u_tau_s=slope.V_tau,
        u_n_s=slope.V_n,
        u_tau_t=V_tau_t,
        u_n_t=V_n_t,
    )
    if water is not None:
        x = _in_moving_water(x, water)
    if immersion is not None:
        x = replace(x, wet=immersion.wet, wetting=immersion.wetting(x.u_n, mid.phi))
    return x


def _in_moving_water(x: Section, water: Float[Array, "2 2"] | LocalWater) -> Section:
    """Returns the section `x`, whose water is still, in moving water.

    The time derivatives follow the body and the slopes are along the body, so in nonuniform water

        (dU/dt)_body = dU/dt + (V . grad) U,    dU/ds = (1 + eps) (tau . grad) U
    """
    U, A = (water.velocity, water.rate) if isinstance(water, LocalWater) else (water[0], water[1])
    U_tau, U_n = to_body(U, x.phi)
    A_tau, A_n = to_body(A, x.phi)
    u_tau_s, u_n_s = x.u_tau_s - x.kappa * U_n, x.u_n_s + x.kappa * U_tau
    gradient = None
    if isinstance(water, LocalWater):
        x_slope, y_slope = water.gradient[:, 0], water.gradient[:, 1]
        tau, n = to_plane(1.0, 0.0, x.phi), to_plane(0.0, 1.0, x.phi)
        tau_slope = to_body(x_slope * tau[0] + y_slope * tau[1], x.phi)
        n_slope = to_body(x_slope * n[0] + y_slope * n[1], x.phi)
        A_tau = A_tau + x.V_tau * tau_slope[0] + x.V_n * n_slope[0]
        A_n = A_n + x.V_tau * tau_slope[1] + x.V_n * n_slope[1]
        u_tau_s = u_tau_s - (1.0 + x.strain) * tau_slope[0]
        u_n_s = u_n_s - (1.0 + x.strain) * tau_slope[1]
        gradient = jnp.stack([tau_slope[1], n_slope[1]])
    return replace(
        x,
        u_tau=x.u_tau - U_tau,
        u_n=x.u_n - U_n,
        u_tau_s=u_tau_s,
        u_n_s=u_n_s,
        u_tau_t=x.u_tau_t - x.omega * U_n - A_tau,
        u_n_t=x.u_n_t + x.omega * U_tau - A_n,
        U_n_gradient=gradient,
    )


def moment_law(mid: Fields, x: Section, moment: Array) -> Float[Array, " cells"]:
    """Returns the residual of the moment law; `moment` is M_extra - M_act [N m]."""
    return mid.M - x.EI * (x.kappa + x.damping_time * x.kappa_t) - moment


def equations(
    mid: Fields, slope: Fields, x: Section, force: tuple[Array, Array], bending: Array
) -> tuple[Float[Array, " cells"], ...]:
    """Returns the residuals of each cell's six equations, in the order of the module docstring.

    `force` is (F_tau, F_n) [N/m]; `bending` is the residual of the moment law [N m], or of the
    condition that replaces this law.
    """
    F_tau, F_n = force
    m, stretch = x.linear_density, 1.0 + x.strain
    return (
        x.strain_t - slope.V_tau + x.kappa * mid.V_n,
        stretch * x.omega - slope.V_n - x.kappa * mid.V_tau,
        bending,
        m * (x.V_tau_t - x.omega * mid.V_n) - slope.T + x.kappa * mid.N - stretch * F_tau,
        m * (x.V_n_t + x.omega * mid.V_tau) - slope.N - x.kappa * mid.T - stretch * F_n,
        slope.M + stretch * mid.N,
    )
