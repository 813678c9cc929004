"""The force of the water on a body in space: its identities, and its limit in the plane."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.equations import Section
from slider_jax.beam.spatial import Quaternion, SpatialSection, SpatialStructure, Vec
from slider_jax.effects.water.drag import NormalDrag
from slider_jax.effects.water.reactive import ReactiveForce

CELLS = 200


def random_section(seed: int = 1) -> SpatialSection:
    """Returns sections of a rigid tangent in still water, with random motion and shape."""
    draw = iter(np.random.default_rng(seed).normal(size=(40, CELLS)))

    def vec():
        return Vec(*(jnp.asarray(next(draw)) for _ in range(3)))

    def scalar(low=0.0, high=1.0):
        return jnp.asarray(low + (high - low) / (1.0 + np.exp(-next(draw))))

    one = jnp.ones(CELLS)
    omega, curvature, V = vec(), vec(), vec()
    # dV/ds + Omega x V = omega x tau, for a body without strain.
    V_s = Vec(0.0 * one, omega.b, -omega.n).minus(curvature.cross(V))
    structure = SpatialStructure(
        linear_density=one, inertia=Vec(one, one, one), stiffness=Vec(one, one, one),
        EA=one, damping_time=one,
        height=scalar(0.02, 0.06), height_s=scalar(-0.1, 0.1), width=scalar(0.0, 0.02),
        width_s=scalar(-0.1, 0.1), s=one, ds=one, in_tail=one, joint=one,
    )  # fmt: skip
    V_t = vec()
    return SpatialSection(
        t=jnp.zeros(()), omega=omega, omega_t=vec(), curvature=curvature, curvature_t=vec(),
        strain=0.0 * one, V=V, V_t=V_t, u=V, u_s=V_s, u_t=V_t, twist_slope=scalar(-1.0, 1.0),
        frame=Quaternion(one, 0.0 * one, 0.0 * one, 0.0 * one), structure=structure,
    )  # fmt: skip


def energy_of(effect: ReactiveForce, x: SpatialSection):
    """Returns E and its partial derivatives dE/dt and dE/ds, each (cells,) [J/m]."""

    def energy(u_n, u_b, slip, height, width):
        unit = effect.m_a * np.pi * effect.density
        m_n, m_b, J = height**2 / 4, width**2 / 4, (height**2 - width**2) ** 2 / 128
        return 0.5 * unit * (m_n * u_n**2 + m_b * u_b**2 + J * slip**2)

    s = x.structure
    zero = jnp.zeros(CELLS)
    at = (x.u.n, x.u.b, x.slip, s.height, s.width)
    E, E_t = jax.jvp(energy, at, (x.u_t.n, x.u_t.b, x.slip_t, zero, zero))
    _, E_s = jax.jvp(energy, at, (x.u_s.n, x.u_s.b, x.slip_s, s.height_s, s.width_s))
    return E, E_t, E_s


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def test_the_power_of_the_force_is_the_loss_of_the_waters_energy():
    """f . V + c_tau omega_tau = -dE/dt + d(u_tau E)/ds, to 1e-9 (THREE_D)."""
    effect, x = ReactiveForce(0.9), random_section()
    load = effect.load_in_space(x)
    E, E_t, E_s = energy_of(effect, x)
    power = dot(load.force, x.V) + load.couple.tau * x.omega.tau
    expected = -E_t + x.u_s.tau * E + x.u.tau * E_s
    np.testing.assert_allclose(power, expected, rtol=0, atol=1e-9 * float(jnp.max(jnp.abs(power))))


def test_a_uniform_untwisted_body_has_no_tangential_force():
    """f_tau = -(m_n' u_n^2 + m_b' u_b^2 + J_A' w^2)/2 - c_tau Omega_tau, to 1e-9."""
    effect, x = ReactiveForce(0.9), random_section(2)
    s, load = x.structure, effect.load_in_space(x)
    unit = effect.m_a * np.pi * effect.density
    m_n_s, m_b_s = unit * s.height * s.height_s / 2, unit * s.width * s.width_s / 2
    slope = 2 * (s.height**2 - s.width**2) * 2 * (s.height * s.height_s - s.width * s.width_s)
    J_s = unit * slope / 128
    expected = -0.5 * (m_n_s * x.u.n**2 + m_b_s * x.u.b**2 + J_s * x.slip**2)
    expected = expected - load.couple.tau * x.curvature.tau
    np.testing.assert_allclose(load.force.tau, expected, rtol=0, atol=1e-9 * float(unit))


@pytest.mark.parametrize("effect", [ReactiveForce(0.9), NormalDrag(2.0)])
def test_the_force_in_the_plane_is_the_planar_force(effect):
    x = random_section(3)
    zero = jnp.zeros(CELLS)
    along = {name: getattr(x, name)._replace(b=zero) for name in ("V", "u", "u_s", "u_t")}
    turning = ("omega", "omega_t", "curvature", "curvature_t")
    about_b = {name: Vec(zero, zero, getattr(x, name).b) for name in turning}
    flat = replace(x, **along, **about_b, twist_slope=zero)
    s = flat.structure
    planar = Section(
        linear_density=s.linear_density, EI=zero, EA=zero, damping_time=zero, height=s.height,
        height_s=s.height_s, s=s.s, ds=s.ds, in_tail=zero, joint=zero, t=flat.t, phi=zero,
        pressure=zero, kappa=flat.curvature.b, kappa_t=flat.curvature_t.b, omega=flat.omega.b,
        strain=zero, strain_t=zero, V_tau=flat.V.tau, V_n=flat.V.n, V_tau_t=zero, V_n_t=zero,
        u_tau=flat.u.tau, u_n=flat.u.n, u_tau_s=flat.u_s.tau, u_n_s=flat.u_s.n,
        u_tau_t=flat.u_t.tau, u_n_t=flat.u_t.n,
    )  # fmt: skip
    F_tau, F_n = effect.force(planar)
    load = effect.load_in_space(flat)
    size = float(jnp.max(jnp.abs(F_n)))
    np.testing.assert_allclose(load.force.n, F_n, rtol=0, atol=1e-13 * size)
    np.testing.assert_allclose(load.force.tau, F_tau, rtol=0, atol=1e-13 * size)
    for value in (load.force.b, *load.couple):
        np.testing.assert_allclose(value, 0.0, atol=1e-13 * size)


def test_added_masses_of_a_plate_and_of_an_ellipse():
    """A body that accelerates from rest along n, along b or about tau feels its added inertia."""
    effect, x = ReactiveForce(1.0), random_section(4)
    none = Vec(*jnp.zeros((3, CELLS)))
    s = x.structure
    still = replace(x, omega=none, curvature=none, curvature_t=none, V=none, u=none, u_s=none)
    load = effect.load_in_space(still)
    rho = effect.density
    np.testing.assert_allclose(load.force.n, -np.pi * rho * s.height**2 / 4 * x.u_t.n)
    np.testing.assert_allclose(load.force.b, -np.pi * rho * s.width**2 / 4 * x.u_t.b)
    J = np.pi * rho * (s.height**2 - s.width**2) ** 2 / 128
    np.testing.assert_allclose(load.couple.tau, -J * x.omega_t.tau)
