"""Effects of body, mounting and water: each against a closed form."""

import dataclasses
import math
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics
from slider_jax.beam.state import straight_state, to_body, to_plane
from slider_jax.dynamics.residual import at_cells
from slider_jax.effects import MOUNT_LAG, Gravity, NormalDrag, ReactiveForce
from slider_jax.effects.base import states_at_rest
from slider_jax.effects.body.axial_flexibility import AxialFlexibility
from slider_jax.effects.body.body_stiffness import BodyStiffness
from slider_jax.effects.body.carried_mass import CarriedMass
from slider_jax.effects.body.internal_friction import InternalFriction
from slider_jax.effects.body.joint_backlash import JointBacklash
from slider_jax.effects.body.joint_compliance import JointCompliance
from slider_jax.effects.body.material_damping import MaterialDamping
from slider_jax.effects.body.mullins_softening import MullinsSoftening
from slider_jax.effects.body.power_damping import PowerDamping
from slider_jax.effects.body.rest_curvature import RestCurvature
from slider_jax.effects.body.side_stiffness import CURVATURE_ROUNDING, SideStiffness
from slider_jax.effects.body.stiffening import Stiffening
from slider_jax.effects.body.stiffness_gradient import StiffnessGradient
from slider_jax.effects.body.stress_relaxation import StressRelaxation
from slider_jax.effects.body.surge_compliance import SurgeCompliance
from slider_jax.effects.body.sway_compliance import SwayCompliance
from slider_jax.effects.body.tail_damping import TailDamping
from slider_jax.effects.body.tail_friction import TailFriction
from slider_jax.effects.body.tail_relaxation import TailRelaxation
from slider_jax.effects.body.tail_rest_curvature import TailRestCurvature
from slider_jax.effects.body.tail_stiffness import TailStiffness
from slider_jax.effects.body.tip_mass import TipMass
from slider_jax.effects.water.amplitude_added_mass import AmplitudeAddedMass
from slider_jax.effects.water.axial_added_mass import AxialAddedMass
from slider_jax.effects.water.crossflow_lift import CrossflowLift
from slider_jax.effects.water.current_buildup import CurrentBuildup
from slider_jax.effects.water.keulegan_carpenter_drag import KeuleganCarpenterDrag
from slider_jax.effects.water.linear_drag import LinearDrag
from slider_jax.effects.water.linear_friction import LinearFriction
from slider_jax.effects.water.side_drag import SideDrag
from slider_jax.effects.water.tail_added_mass import TailAddedMass
from slider_jax.effects.water.tail_drag import TailDrag
from slider_jax.effects.water.tangential_friction import TangentialFriction
from slider_jax.effects.water.tank_current import TankCurrent
from slider_jax.effects.water.tank_seiche import TankSeiche
from tests.support.helpers import (
    SMALL,
    arrays,
    dense_newton,
    march,
    nodes_of,
    stage_of,
    swimmer,
    uniform,
)

L, TAIL, BODY, EI, H, RHO = 0.368, 0.2 * 0.368, 0.8 * 0.368, 0.038, 0.03, 1000.0
FINE = Numerics(tail_cells=20, body_cells=80)
MOUNTINGS = (SurgeCompliance, SwayCompliance)


def settled(effects, tail_load=None, dt=1e9, **robot):
    """Returns the unknowns (6, N) of the clamped rod one step `dt` [s] after it was straight."""
    model = uniform(L, effects=effects, **robot)
    model = dataclasses.replace(model, robot=model.body)
    y, _ = straight_state(nodes_of(model, SMALL))
    stage = stage_of(model, SMALL, y, dt)
    internal = states_at_rest(model.effects, y[0, 1:])
    stage = dataclasses.replace(
        stage, reference=dataclasses.replace(stage.reference, internal=internal)
    )
    y, error = dense_newton(stage, y, tail_load)
    assert error < 1e-9
    return y


def end_load(T=0.0, N=0.0, M=0.0):
    """Loads at the tail's end, in axes that rotate with the tail."""
    return jax.tree_util.Partial(_same_at_any_angle, jnp.asarray([T, N, M], float))


def _same_at_any_angle(load, phi):
    return load + 0.0 * phi


def rigid(numerics=FINE, phi=0.0, omega=0.0, omega_t=0.0, V=(0.0, 0.0), A=(0.0, 0.0), water_A=None):
    """Section of the straight rod that moves rigidly; V, A: of its head, in the plane."""
    return _rigid(numerics, *arrays((phi, omega, omega_t, V, A)), arrays(water_A))


@eqx.filter_jit
def _rigid(numerics, phi, omega, omega_t, V, A, water_A):
    model = uniform(L)
    s = nodes_of(model, numerics)
    r, zero = s - L, jnp.zeros_like(s)
    V_tau, V_n = to_body(V, phi)
    A_tau, A_n = to_body(A, phi)
    y = jnp.stack([zero, zero, zero, V_tau + zero, V_n + omega * r, phi + zero])
    rates = [A_tau + omega * V_n + zero, A_n - omega * V_tau + omega_t * r, omega + zero]
    stage = stage_of(model, numerics, y - jnp.stack([zero, zero, zero, *rates]), 1.0)
    if water_A is not None:
        water = jnp.stack([jnp.zeros(2), jnp.asarray(water_A)])
        stage = dataclasses.replace(stage, water=water)
    return at_cells(y, stage)


def resultant(effect, x):
    """Force (tau, n) [N] and moment about the head [N m]."""
    return _resultant(arrays(effect), x)


@eqx.filter_jit
def _resultant(effect, x):
    F_tau, F_n = effect.force(x)
    return jnp.sum(F_tau * x.ds), jnp.sum(F_n * x.ds), jnp.sum(F_n * (x.s - L) * x.ds)


# Body


def test_a_couple_bends_body_and_tail_by_their_changed_stiffness():
    C = 0.01
    y = settled((BodyStiffness(0.25), TailStiffness(-0.4)), end_load(M=-C))
    np.testing.assert_allclose(y[5, 0], C * BODY / EI / 1.25 + C * TAIL / EI / 0.6, rtol=1e-9)


def test_a_pull_stretches_the_body_by_its_added_compliance():
    T, c = 2.0, 2e-3
    y = settled((AxialFlexibility(c),), end_load(T=T), dt=1.0, linear_density=0.0, EA_tail=500.0)
    extension = T * (BODY * (1e-6 + c) + TAIL / 500.0)
    np.testing.assert_allclose(y[3, -1] - y[3, 0], extension, rtol=1e-9)


def test_damping_slows_a_body_without_mass():
    """One implicit step under a couple: EI kappa (1 + alpha/dt) = C."""
    C, dt, alpha = 0.01, 2e-3, 3e-3
    y = settled((MaterialDamping(0.5),), end_load(M=-C), dt, linear_density=0.0, damping_time=alpha)
    np.testing.assert_allclose(y[5, 0], C * L / EI / (1.0 + 1.5 * alpha / dt), rtol=1e-9)


def test_carried_mass_adds_to_the_inertia():
    y = settled((CarriedMass(0.2), Gravity(9.81)))
    np.testing.assert_allclose(y[0, -1], (0.7 + 0.2) * 9.81 * L, rtol=1e-5)


# Bending moments


def test_a_stiffening_body_follows_the_cubic():
    C, beta = 0.3, 2e-4
    y = settled((Stiffening(beta),), end_load(M=-C))
    (kappa,) = [r.real for r in np.roots([beta, 0.0, EI, -C]) if abs(r.imag) < 1e-9]
    assert kappa < 0.9 * C / EI
    np.testing.assert_allclose(y[5, 0], kappa * BODY + C / EI * TAIL, rtol=1e-9)


def test_a_bent_body_rests_at_its_curvature_and_its_tail_is_straight():
    m_0 = 0.02
    y = settled((RestCurvature(m_0),))
    tail = SMALL.tail_cells
    np.testing.assert_allclose(y[5, tail], -m_0 / EI * BODY, rtol=1e-9)
    np.testing.assert_allclose(y[5, : tail + 1], y[5, tail], rtol=1e-9)


def moments(effect, kappa, dt):
    """Moment (n,) [N m] along a curvature (n,) that starts at zero, by Euler's steps.

    The moment must be the same in all cells of the effect's segments, and zero in other cells.
    """
    x = rigid(SMALL)

    def step(carry, now):
        memory, before = carry
        bent = dataclasses.replace(
            x, kappa=now + 0.0 * x.s, kappa_t=(now - before) / dt + 0.0 * x.s
        )
        moment, memory = effect.moment(bent, memory, jnp.asarray(dt))
        return (memory, now), moment

    _, series = jax.lax.scan(step, (jnp.zeros_like(x.s), jnp.asarray(0.0)), kappa)
    parts = dict(zip(("tail", "body"), np.split(series, [SMALL.tail_cells], axis=1), strict=True))
    moment = np.asarray(parts[effect.segments[0]][:, 0])
    for name, part in parts.items():
        expected = moment if name in effect.segments else 0.0 * moment
        np.testing.assert_array_equal(part, np.broadcast_to(expected[:, None], part.shape))
    return moment


def test_rubber_is_soft_only_below_its_largest_previous_strain():
    """Loading to 3 1/m, unloading to 1 1/m, and loading in the other direction to 4 1/m."""
    effect, q, found = MullinsSoftening(0.6, 2.0), jnp.zeros(2), []
    for kappa in (1.0, 3.0, 1.0, -4.0, 3.0):
        x = SimpleNamespace(kappa=jnp.full(2, kappa), EI=EI, in_tail=jnp.array([0.0, 1.0]))
        moment, q = effect.moment(x, q, 1e-3)
        found.append(np.asarray(moment) / (EI * kappa))
    first, second = (-0.6 * math.erf(x / 4.0) for x in (9.0 - 1.0, 16.0 - 9.0))
    expected = np.array([0.0, 0.0, first, 0.0, second])
    np.testing.assert_allclose(np.array(found)[:, 0], expected, atol=1e-12)
    np.testing.assert_array_equal(np.array(found)[:, 1], 0.0)


@pytest.mark.parametrize("kind", [StressRelaxation, TailRelaxation])
def test_a_held_bend_relaxes_exponentially(kind):
    E_1, tau, kappa, dt = 0.01, 0.2, 3.0, 1e-4
    t = dt * np.arange(1.0, 4001.0)
    M = moments(arrays(kind(E_1, tau)), kappa + jnp.zeros_like(t), dt)
    np.testing.assert_allclose(M, E_1 * kappa * np.exp(-t / tau), rtol=2e-3)


def test_the_standard_solid_has_its_complex_modulus():
    E_1, tau, w, n = 0.01, 0.07, 2.0 * np.pi * 3.0, 4000
    dt = 2.0 * np.pi / w / n
    t = dt * np.arange(1.0, 6 * n + 1.0)
    M = moments(arrays(StressRelaxation(E_1, tau)), jnp.sin(w * t), dt)[-n:]
    modulus = 2.0 * np.mean(M * (np.sin(w * t[-n:]) + 1j * np.cos(w * t[-n:])))
    np.testing.assert_allclose(modulus, E_1 * 1j * w * tau / (1.0 + 1j * w * tau), rtol=2e-3)


@pytest.mark.parametrize("kind", [InternalFriction, TailFriction])
@pytest.mark.parametrize("frequency", [2.0, 8.0])
def test_dry_friction_takes_the_same_energy_at_any_rate(frequency, kind):
    """Dahl's loop between -A and A: q = 1 - (1 + tanh(A/k)) exp(-(kappa + A)/k) on the way up."""
    z_c, k, A, n = 0.02, 0.3, 2.0, 8000
    dt = 1.0 / frequency / n
    kappa = A * jnp.sin(2.0 * jnp.pi * jnp.arange(0.0, 3.0 * n + 1.0) / n)
    M = moments(arrays(kind(z_c, k)), kappa, dt)
    energy = np.sum(M[-n:] * np.diff(kappa)[-n:])
    exact = 4.0 * z_c * (A - k * np.tanh(A / k))
    np.testing.assert_allclose(energy, exact, rtol=0.01)
    np.testing.assert_allclose(np.abs(M).max(), z_c * np.tanh(A / k), rtol=0.01)


@pytest.mark.parametrize("n", [0.5, 1.0, 1.5])
def test_power_damping_is_a_power_of_a_constant_bending_rate(n):
    c, dt = 0.3, 1e-3
    effect = arrays(PowerDamping(c, n))
    for rate in (400.0, -2000.0):
        M = moments(effect, rate * dt * jnp.arange(1.0, 4.0), dt)
        exact = EI * c * np.sign(rate) * (abs(rate) / 100.0) ** n
        np.testing.assert_allclose(M, exact, rtol=5e-4)


# Distribution along the body, sides and joint


def curvature(y):
    """Curvature (cells,) [1/m] of the rod."""
    return np.diff(y[5]) / np.diff(nodes_of(uniform(L), SMALL))


def test_a_stiffness_gradient_makes_the_end_at_the_head_stiffer():
    C, g = 0.01, 0.6
    s = nodes_of(uniform(L), SMALL)
    xi = (0.5 * (s[1:] + s[:-1]) - TAIL - 0.5 * BODY) / BODY
    stiffness = EI * np.where(xi > -0.5, 1.0 + g * xi, 1.0)
    kappa = curvature(settled((StiffnessGradient(g),), end_load(M=C)))
    np.testing.assert_allclose(kappa, C / stiffness, rtol=1e-9)
    assert kappa[-1] < kappa[SMALL.tail_cells]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_body_with_sides_bends_more_to_its_soft_side(sign):
    C, d, w, tail = 0.2, 0.25, CURVATURE_ROUNDING, SMALL.tail_cells
    kappa = curvature(settled((SideStiffness(d),), end_load(M=sign * C)))
    exact = (sign * C / EI + d * w) / (1.0 + sign * d)
    np.testing.assert_allclose(kappa[tail:], exact, rtol=d * w**2 / exact**2)
    np.testing.assert_allclose(kappa[:tail], sign * C / EI, rtol=1e-9)


def test_a_tail_bent_at_rest_has_its_curvature_and_its_body_is_straight():
    kappa_0, tail = 1.5, SMALL.tail_cells
    kappa = curvature(settled((TailRestCurvature(kappa_0),)))
    np.testing.assert_allclose(kappa[:tail], kappa_0, rtol=1e-9)
    np.testing.assert_allclose(kappa[tail:], 0.0, atol=1e-9)


def test_tail_damping_slows_only_the_tail():
    """One implicit step under a couple, as in the test of the material's damping."""
    C, dt, alpha, a = 0.01, 2e-3, 3e-3, 5e-3
    effects = (TailDamping(a),)
    y = settled(effects, end_load(M=-C), dt, linear_density=0.0, damping_time=alpha)
    tail = C * TAIL / EI / (1.0 + (alpha + a) / dt)
    np.testing.assert_allclose(y[5, 0], C * BODY / EI / (1.0 + alpha / dt) + tail, rtol=1e-9)


def test_a_soft_joint_rotates_by_its_compliance():
    C, c, tail = 0.01, 4.0, SMALL.tail_cells
    y = settled((JointCompliance(c),), end_load(M=C))
    np.testing.assert_allclose(-y[5, 0], C * L / EI + c * C, rtol=1e-9)
    kappa = curvature(y)
    away = np.r_[: tail - 1, tail + 1 : len(kappa)]
    np.testing.assert_allclose(kappa[away], C / EI, rtol=1e-9)


def test_a_joint_with_backlash_rotates_freely_by_its_play():
    """Beyond the play, the rotation is g; far below the stop, it is g M/(EI w)."""
    g, w, C = 2e-3, 0.01, 0.2
    y = settled((JointBacklash(g, w),), end_load(M=-C))
    np.testing.assert_allclose(y[5, 0] - C * L / EI, g, rtol=1e-3)
    g, w, C = 0.02, 1.0, 1e-5
    y = settled((JointBacklash(g, w),), end_load(M=-C))
    np.testing.assert_allclose(y[5, 0] - C * L / EI, g * C / (EI * w), rtol=1e-5)


# Forces of the water and of masses


def test_linear_drag_brakes_a_turning_rod():
    c, omega = 1.5, 2.0
    _, _, moment = resultant(LinearDrag(c), rigid(omega=omega))
    np.testing.assert_allclose(moment, -c * omega * L**3 / 3.0, rtol=1e-4)


@pytest.mark.parametrize("U", [0.4, -0.4])
def test_linear_friction_resists_axial_motion(U):
    F_tau, F_n, _ = resultant(LinearFriction(1.2), rigid(V=(U, 0.3)))
    np.testing.assert_allclose(F_tau, -1.2 * U * L, rtol=1e-12)
    assert F_n == 0.0


@pytest.mark.parametrize("omega", [2.0, -2.0])
def test_side_drag_has_the_same_direction_for_both_directions_of_motion(omega):
    F_tau, F_n, _ = resultant(SideDrag(0.6), rigid(omega=omega))
    np.testing.assert_allclose(F_n, -0.5 * RHO * 0.6 * H * omega**2 * L**3 / 3.0, rtol=1e-4)
    assert F_tau == 0.0


@pytest.mark.parametrize("U", [0.5, -0.5])
def test_the_lift_resists_the_crossflow_in_both_axial_directions(U):
    C, u_n = 0.8, 0.1
    _, F_n, _ = resultant(CrossflowLift(C), rigid(V=(U, u_n)))
    np.testing.assert_allclose(F_n, -0.5 * RHO * C * H * L * abs(U) * u_n, rtol=1e-5)


def test_added_mass_grows_with_the_stroke_amplitude():
    """In a sinusoidal stroke, KC is constant, so the force is that of a constant added mass."""
    f, c, cells = 4.0, 0.2, FINE.tail_cells + FINE.body_cells
    phase = 2.0 * jnp.pi * jnp.arange(float(cells)) / cells
    effect = arrays(AmplitudeAddedMass(c, stride_frequency=f))
    for KC in (2.0, 8.0):
        U = KC * f * H
        u_n, u_n_t = U * jnp.cos(phase), -2.0 * jnp.pi * f * U * jnp.sin(phase)
        F_n = effect.force(dataclasses.replace(rigid(), u_n=u_n, u_n_t=u_n_t))[1]
        m_A = c * KC * math.pi * RHO * H**2 / 4.0
        np.testing.assert_allclose(F_n, -m_A * u_n_t, rtol=2e-3, atol=1e-9)


def test_tail_drag_brakes_a_turning_rod_by_its_tail():
    C, omega = 1.2, 2.0
    _, _, moment = resultant(TailDrag(C), rigid(omega=omega))
    exact = -0.5 * RHO * C * H * omega**2 * (L**4 - BODY**4) / 4.0
    np.testing.assert_allclose(moment, exact, rtol=1e-3)


def test_the_tail_in_a_stream_has_the_lift_of_a_slender_wing():
    """Jones: lift = (rho U^2/2) (pi/2) (H^2/S) S alpha, at the leading edge, here the joint."""
    m_a, U, alpha = 0.8, 0.5, 1e-3
    x = rigid(Numerics(tail_cells=10, body_cells=80), V=(U, U * alpha))
    _, F_n, moment = resultant(TailAddedMass(m_a), x)
    lift = m_a * 0.5 * RHO * U**2 * 0.5 * np.pi * H**2 * alpha
    np.testing.assert_allclose(F_n, -lift, rtol=1e-9)
    np.testing.assert_allclose(moment, lift * BODY, rtol=1e-9)


def test_tail_added_mass_balances_the_momentum_of_its_water():
    """Lighthill's form: d/dt of the momentum along the tail, plus the flux at the tip."""
    m_a, phi, omega, omega_t = 0.7, 0.4, 3.0, 20.0
    V, A = jnp.asarray([0.3, -0.2]), jnp.asarray([2.0, 1.0])
    m_A = m_a * math.pi * RHO * H**2 / 4.0

    def motion(t):
        angle = phi + omega * t + 0.5 * omega_t * t**2
        return angle, omega + omega_t * t, to_body(V + A * t, angle)

    def momentum(t):
        angle, turning, (_, V_n) = motion(t)
        inside = m_A * (V_n * TAIL + turning * (BODY**2 - L**2) / 2.0)
        return jnp.stack(to_plane(0.0, inside, angle))

    u_tau, u_n = to_body(V, phi)
    u_n = u_n - omega * L
    leaving = jnp.stack(to_plane(-m_A * u_n**2 / 2.0, m_A * u_tau * u_n, phi))
    exact = -jax.jvp(momentum, (0.0,), (1.0,))[1] - leaving
    F_tau, F_n, _ = resultant(TailAddedMass(m_a), rigid(FINE, phi, omega, omega_t, V, A))
    found = to_plane(F_tau, F_n, phi)
    np.testing.assert_allclose(found, exact, atol=1e-3 * np.linalg.norm(exact))


def test_axial_added_mass_on_a_rotating_rod_has_a_centrifugal_force():
    m_t, omega = 0.1, 3.0
    F_tau, F_n, _ = resultant(AxialAddedMass(m_t), rigid(omega=omega, omega_t=5.0, phi=0.3))
    np.testing.assert_allclose(F_tau, -m_t * omega**2 * L**2 / 2.0, rtol=1e-9)
    assert F_n == 0.0


def test_axial_added_mass_feels_only_acceleration_relative_to_the_water():
    m_t, A = 0.1, (0.7, -0.4)
    effect = AxialAddedMass(m_t)
    along = A[0] * np.cos(0.3) + A[1] * np.sin(0.3)
    moved, _, _ = resultant(effect, rigid(phi=0.3, V=(0.2, 0.1), omega=2.0, A=A))
    turned, _, _ = resultant(effect, rigid(phi=0.3, V=(0.2, 0.1), omega=2.0))
    np.testing.assert_allclose(moved - turned, -m_t * along * L, rtol=1e-9)
    flooded, _, _ = resultant(effect, rigid(phi=0.3, water_A=A))
    np.testing.assert_allclose(flooded, m_t * along * L, rtol=1e-9)
    together = rigid(phi=0.3, A=A, water_A=A)
    np.testing.assert_allclose(effect.force(together)[0], 0.0, atol=1e-12)


@pytest.mark.parametrize("numerics", [SMALL, FINE])
def test_a_tip_mass_resists_with_all_of_its_mass(numerics):
    mass, A, phi = 3e-3, (2.0, -1.0), 0.3
    x = rigid(numerics, phi, V=(0.4, 0.1), A=A)
    F_tau, F_n, _ = resultant(TipMass(mass), x)
    np.testing.assert_allclose(to_plane(F_tau, F_n, phi), [-mass * a for a in A], rtol=1e-9)


def test_a_tip_mass_rotates_at_the_radius_of_its_centre():
    """The mass covers three cells exactly; it has a centrifugal force and rotational inertia."""
    mass, omega, omega_t, length = 3e-3, 4.0, 30.0, 3.0 * TAIL / 20.0
    x = rigid(phi=0.3, omega=omega, omega_t=omega_t, V=(0.4, 0.1))
    F_tau, _, moment = resultant(TipMass(mass, length), x)
    middle = L - length / 2.0
    np.testing.assert_allclose(F_tau, -mass * omega**2 * middle, rtol=1e-9)
    inertia = mass * (middle**2 + length**2 / 12.0)
    np.testing.assert_allclose(moment, -inertia * omega_t, rtol=1e-5)


def test_a_plates_drag_in_strokes_is_grahams():
    """Mean power 4/(3 pi) of the largest; the coefficient 8 KC^(-1/3) holds over the stride."""
    f, cells = 4.0, FINE.tail_cells + FINE.body_cells
    phase = 2.0 * jnp.pi * jnp.arange(float(cells)) / cells
    effect = arrays(KeuleganCarpenterDrag(8.0, stride_frequency=f))
    for KC in (2.0, 8.0):
        U = KC * f * H
        u_n, u_n_t = U * jnp.cos(phase), -2.0 * jnp.pi * f * U * jnp.sin(phase)
        x = dataclasses.replace(rigid(), u_n=u_n, u_n_t=u_n_t)
        power = -jnp.mean(effect.force(x)[1] * u_n)
        C_d = power / (0.5 * RHO * H * U**3 * 4.0 / (3.0 * jnp.pi))
        np.testing.assert_allclose(C_d, 8.0 * KC ** (-1.0 / 3.0), rtol=5e-3)


def test_the_gradient_of_the_drag_in_strokes_is_finite_at_rest():
    effect = arrays(KeuleganCarpenterDrag(8.0))
    x = rigid()

    def total(u):
        moving = dataclasses.replace(x, u_n=u + 0.0 * x.s, u_n_t=u + 0.0 * x.s)
        return jnp.sum(effect.force(moving)[1])

    assert jax.grad(total)(0.0) == 0.0


# Motion of the water


def test_a_current_pushes_a_rigid_rod():
    U_x, U_y, C_t, C_d = -0.04, 0.03, 0.05, 2.0
    y = settled(
        (TankCurrent(U_x, U_y), TangentialFriction(C_t), NormalDrag(C_d)), EI_body=1e6, EI_tail=1e6
    )
    thrust, recoil = -y[0, -1], -y[1, -1]
    np.testing.assert_allclose(thrust, RHO * C_t * H * L * U_x * abs(U_x), rtol=1e-6)
    np.testing.assert_allclose(recoil, 0.5 * RHO * C_d * H * L * U_y * abs(U_y), rtol=1e-6)


def test_a_current_builds_up_from_still_water():
    U, tau = -0.15, 3.0
    t = jnp.asarray([0.0, tau, 30.0 * tau])
    U_x, U_y = jax.vmap(arrays(CurrentBuildup(U, tau)).velocity)(t)
    np.testing.assert_allclose(U_x, [0.0, U * (1.0 - math.exp(-1.0)), U], rtol=1e-12)
    assert not np.any(U_y)


def test_a_seiche_moves_water_back_and_forth():
    """A parcel's path over half a period and back; the phase is where it turns."""
    a_cos, a_sin, f = 0.012, 0.005, 0.5
    seiche = arrays(TankSeiche(a_cos, a_sin, f))
    turn = (math.atan2(a_sin, a_cos) - 0.5 * math.pi) / (2.0 * math.pi * f)
    t = turn + np.linspace(0.0, 1.0 / f, 2001)
    U_x, U_y = jax.vmap(seiche.velocity)(jnp.asarray(t))
    assert not np.any(U_y)
    path = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (U_x[1:] + U_x[:-1]))])
    stroke = 2.0 * math.hypot(a_cos, a_sin) / (2.0 * math.pi * f)
    np.testing.assert_allclose([path.max(), path[1000], path[-1]], [stroke, stroke, 0.0], atol=1e-8)


def test_the_default_seiche_frequency_is_that_of_a_tank_of_one_metre():
    k = math.pi / 1.0
    f = math.sqrt(9.81 * k * math.tanh(k * 0.3)) / (2.0 * math.pi)
    assert abs(TankSeiche().frequency - f) < 0.005


# Mounting


def test_the_mounting_yields_in_the_direction_of_the_load():
    """A push on the tail moves the head forward, a load to the side moves it there."""
    surge, sway, dt = 2e-4, 5e-4, 1e3
    effects = (SurgeCompliance(surge), SwayCompliance(sway))
    y = settled(effects, end_load(T=-3.0, N=0.01), dt, EI_body=1e3, EI_tail=1e3)
    thrust, recoil = -y[0, -1], -y[1, -1]
    assert thrust > 2.9 and recoil < -0.009
    np.testing.assert_allclose(dt * y[3, -1], surge * thrust, rtol=1e-4)
    np.testing.assert_allclose(dt * y[4, -1], sway * recoil, rtol=1e-4)


@pytest.mark.slow
def test_the_mounting_is_passive():
    """Its work over a swim is c load^2/2 in the springs; the dashpots dissipate the rest."""
    compliance = np.array([2e-4, 5e-4])
    effects = (NormalDrag(3.0), ReactiveForce(1.0))
    effects = (*effects, *(kind(c) for kind, c in zip(MOUNTINGS, compliance, strict=True)))

    def save(x):
        return x.y[:2, -1], x.y[3:5, -1], x.head

    h = 1.0 / 4.8 / 320.0
    _, (load, V, head) = march(swimmer(effects=effects), h, 640, save)
    work = -np.sum(load * V, axis=0) * h
    stored = 0.5 * head[-1] ** 2 / compliance
    lost = MOUNT_LAG / compliance * np.sum(V**2, axis=0) * h
    print(f"work {work}, stored {stored}, lost {lost} J")
    np.testing.assert_allclose(work, stored + lost, rtol=0.02)
