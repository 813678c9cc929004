"""A robot in three dimensions: planar limit, frequencies, decay, statics, order, derivatives."""

import itertools
import math
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from slider_jax.actuation import LengthTendon, SineWave
from slider_jax.beam.parameters import Numerics
from slider_jax.beam.spatial import Vec, about_tau, rate_of, rotation_vector, turned, turning_of
from slider_jax.dynamics.model import SpaceSettings
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.time_schemes import BACKWARD_EULER, SDIRK2
from slider_jax.effects import NormalDrag, ReactiveForce, total_load
from slider_jax.effects.body.axial_flexibility import AxialFlexibility
from slider_jax.effects.body.carried_mass import CarriedMass
from slider_jax.effects.body.gravity import Gravity
from slider_jax.effects.body.material_damping import MaterialDamping
from slider_jax.effects.body.tail_stiffness import TailStiffness
from slider_jax.effects.body.tip_mass import TipMass
from slider_jax.effects.water.tangential_friction import TangentialFriction
from slider_jax.errors import InputError
from slider_jax.rod.equilibrium import solve_equilibrium
from slider_jax.rod.loads import RodLoads
from slider_jax.rod.rod import Rod
from slider_jax.spatial.step import at_rest_in_space, spatial_rollout
from slider_jax.supports import Clamped, Free, PinnedLink
from tests.support.helpers import SMALL, arrays, order, swimmer, uniform

L, EI_N, EI_B, GJ, J, MASS = 0.368, 0.152, 0.038, 0.05, 2e-5, 0.7
NUM = Numerics(tail_cells=8, body_cells=32)


def spatial(model, GJ=GJ, EI_n=EI_N, J=J, angles=(0.0, 0.0)):
    """Returns the model with the properties that a robot in three dimensions needs."""
    robot = model.robot.with_parts(lambda p: replace(p, GJ=GJ, EI_n=EI_n, polar_inertia=J))
    return arrays(replace(model, robot=robot, space=SpaceSettings(jnp.asarray(angles))))


def moving(begin, V=None, omega=None):
    """Returns the carry with other velocities [m/s] or turning rates [rad/s] at the nodes."""
    V = begin.memory.V if V is None else V
    omega = begin.memory.omega if omega is None else omega
    return eqx.tree_at(
        lambda c: (c.memory.V, c.memory.omega, c.history),
        begin,
        (V, omega, begin.history.at[:, 6:9].set(V)),
    )


@pytest.mark.parametrize(
    "support",
    [
        Free(speed=0.1),
        pytest.param(Clamped(tow_speed=0.1), marks=pytest.mark.slow),
        pytest.param(PinnedLink(0.03, 2.0), marks=pytest.mark.slow),
    ],
)
def test_a_planar_run_in_rotated_planes_is_the_planar_programs(support):
    """Readings agree to 1e-8 in three planes, and nothing moves out of the plane."""
    of_body = (MaterialDamping(0.5), CarriedMass(0.1), AxialFlexibility(1e-4), TipMass(3e-3))
    effects = (ReactiveForce(1.0), NormalDrag(2.0), TangentialFriction(0.02), *of_body)
    model = spatial(swimmer(2.0, 30e3, wave=SineWave, support=support, effects=effects))
    numerics = replace(SMALL, tolerance=1e-11)
    times = TimeGrid(0.01, 25)
    flat = replace(model, space=None)
    planar = jax.jit(lambda: rollout(flat, times, lambda x: (x.y, x.head), numerics))()

    @jax.jit
    def run(attitude):
        begin = at_rest_in_space(model, numerics, 0.0, attitude)
        save = lambda x: (x.y, x.memory.head)  # noqa: E731
        return spatial_rollout(model, times, save, numerics, begin=begin)

    for angle in (0.0, 1.0, math.pi / 2):
        found = run(about_tau(jnp.asarray(angle)))
        assert planar.ok and found.ok
        (y, head), (z, place) = planar.saved, found.saved
        for mine, theirs in zip((0, 5, 6, 7), (0, 2, 3, 4), strict=True):
            size = np.abs(y[:, theirs]).max()
            np.testing.assert_allclose(z[:, mine], y[:, theirs], rtol=0, atol=1e-8 * size)
        for out_of_plane in (2, 3, 4, 8):
            assert np.abs(z[:, out_of_plane]).max() < 1e-12
        turned = np.array([np.ones(25), np.full(25, np.cos(angle)), np.full(25, np.sin(angle))]).T
        np.testing.assert_allclose(place, turned * np.array(head)[:, [0, 1, 1]], atol=1e-10)


def first_bending_mode(s, row):
    """Returns V and omega at the nodes in the first mode of a cantilever, along n or b."""
    k = 1.875104068711961 / L
    x = k * (L - s)
    c = (np.cosh(k * L) + np.cos(k * L)) / (np.sinh(k * L) + np.sin(k * L))
    V = np.zeros((3, len(s)))
    omega = np.zeros((3, len(s)))
    V[row] = np.cosh(x) - np.cos(x) - c * (np.sinh(x) - np.sin(x))
    slope = -k * (np.sinh(x) + np.sin(x) - c * (np.cosh(x) - np.cos(x)))
    omega[3 - row] = slope if row == 1 else -slope
    return jnp.asarray(1e-3 * V), jnp.asarray(1e-3 * omega)


@pytest.mark.slow
def test_torsional_and_bending_frequencies():
    """First frequencies of a cantilever in torsion and in both planes of bending, to 0.5 %."""
    model = spatial(uniform(L=L, EI=EI_B, EA_body=1e7, EA_tail=1e7))

    @jax.jit
    def run(h, V, omega):
        begin = moving(at_rest_in_space(model, NUM), V, omega)
        save = lambda x: jnp.stack([x.memory.omega[0, 0], *x.memory.V[1:, 0]])  # noqa: E731
        return spatial_rollout(model, TimeGrid(h, 250), save, NUM, begin=begin, checkpoint=False)

    s = np.linspace(0.0, L, 41)
    twist = jnp.zeros((3, 41)).at[0].set(0.1 * np.cos(np.pi * s / (2 * L)))
    bending = 1.875104068711961**2 / (2 * np.pi * L**2)
    cases = [
        (0, np.sqrt(GJ / J) / (4 * L), jnp.zeros((3, 41)), twist),
        (1, bending * np.sqrt(EI_B / MASS), *first_bending_mode(s, 1)),
        (2, bending * np.sqrt(EI_N / MASS), *first_bending_mode(s, 2)),
    ]
    for row, frequency, V, omega in cases:
        found = run(0.01 / frequency, V, omega)
        assert found.ok
        x, t = np.array(found.saved[:, row]), np.array(found.t)
        down = np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))
        zero = t[down] - x[down] * (t[down + 1] - t[down]) / (x[down + 1] - x[down])
        assert 1.0 / (zero[1] - zero[0]) == pytest.approx(frequency, rel=5e-3)


@pytest.mark.slow
def test_spin_and_slip_decay_and_buoyancy_rights_the_body():
    """omega0/(1 + omega0 K t/J) and u0/(1 + u0 rho C_d H t/(2 (m + m_A))), to 1e-4; without drag, a
    roll of phi0 becomes phi0 cos(t sqrt(rho A g d/J)), to 1e-3 of phi0."""
    rho, g, d, phi0 = 1000.0, 9.81, 0.005, 0.01

    def model_of(C_d, g):
        gravity = Gravity(g, elevation=math.pi / 2, buoyancy_b=d, density=rho)
        effects = (ReactiveForce(1.0), NormalDrag(C_d), gravity)
        model = spatial(uniform(L=L, EI=EI_B, effects=effects, support=Free()))
        afloat = model.robot.with_parts(lambda p: replace(p, area=jnp.asarray(MASS / rho)))
        return replace(model, robot=afloat)

    @jax.jit
    def run(model, begin):
        save = lambda x: (x.memory.omega[0, 3], x.memory.V[1, 3], x.frame)  # noqa: E731
        return spatial_rollout(
            model, TimeGrid(1e-3, 100), save, SMALL, begin=begin, checkpoint=False
        )

    nodes, H = SMALL.nodes, 0.03
    none, heavy = jnp.zeros((3, nodes)), model_of(2.0, 0.0)
    still = at_rest_in_space(heavy, SMALL)
    spin = run(heavy, moving(still, none, none.at[0].set(50.0)))
    slip = run(heavy, moving(still, none.at[1].set(0.5), none))
    t = np.array(spin.t)
    inertia, K = J + np.pi * rho * H**4 / 128, rho * 2.0 * H**4 / 64
    np.testing.assert_allclose(spin.saved[0], 50 / (1 + 50 * K * t / inertia), rtol=1e-4)
    mass = MASS + np.pi * rho * H**2 / 4
    np.testing.assert_allclose(slip.saved[1], 0.5 / (1 + 0.5 * rho * 2 * H * t / (2 * mass)), 1e-4)
    norm = np.linalg.norm(np.array(spin.saved[2]), axis=1)
    np.testing.assert_allclose(norm, 1.0, rtol=0, atol=1e-12)
    rolled = at_rest_in_space(heavy, SMALL, 0.0, about_tau(jnp.asarray(phi0)))
    roll = 2.0 * np.array(run(model_of(0.0, g), rolled).saved[2])[:, 1, 3]
    right = phi0 * np.cos(t * np.sqrt(MASS * g * d / inertia))
    np.testing.assert_allclose(roll, right, rtol=0, atol=1e-3 * phi0)


@pytest.mark.slow
def test_a_rolled_strip_under_its_weight_hangs_as_the_static_rod():
    """Bending in two planes with torsion; the tip agrees with the static solver to 0.1 % of L."""
    effects = (Gravity(12.0, elevation=math.pi / 2),)
    model = spatial(uniform(L=L, EI=EI_B, effects=effects, EA_body=1e6, EA_tail=1e6))
    roll = 0.5
    begin = at_rest_in_space(model, NUM, 0.0, about_tau(jnp.asarray(roll)))
    found = jax.jit(
        lambda b: spatial_rollout(
            model, TimeGrid(0.02, 500), lambda x: x.positions()[:, 0], NUM, BACKWARD_EULER, begin=b
        )
    )(begin)
    one = jnp.ones(40)
    c, s = np.cos(roll), np.sin(roll)
    rod = Rod(
        ds=one * L / 40,
        stiffness=jnp.stack([GJ * one, EI_N * one, EI_B * one], axis=1),
        initial_curvature=jnp.zeros((40, 3)),
        clamp=jnp.array([[-1.0, 0.0, 0.0], [0.0, c, s], [0.0, s, -c]]),
        weight=MASS * 12.0 * one,
    )
    down = jnp.array([0.0, 0.0, -1.0])
    rest = solve_equilibrium(rod, RodLoads(jnp.zeros(3), jnp.zeros(3), down)).shape.position[-1]
    assert found.ok
    assert abs(rest[1]) > 0.05
    np.testing.assert_allclose(found.saved[-1], rest, rtol=0, atol=1e-3 * L)


def strip_swimmer(angle=jnp.asarray(0.7), C_d=2.0, EI=0.02, **in_space):
    """A swimmer whose chambers are off the planes of symmetry of its section."""
    robot = {"EI_body": EI}
    model = swimmer(4.8, wave=SineWave, phase=0.0, C_d=C_d, k=0.05, support=Free(), **robot)
    return spatial(model, angles=jnp.stack([angle, -angle]), **in_space)


def readings(model, steps, span, numerics, scheme=SDIRK2):
    def save(x):
        return jnp.concatenate([x.positions()[:, 0], x.positions()[:, -1], x.memory.omega[:, 0]])

    times = TimeGrid(span / steps, steps)
    return spatial_rollout(model, times, save, numerics, scheme)


def dot(p, q):
    return sum(x * y for x, y in zip(p, q, strict=True))


class Balance(NamedTuple):
    """Powers [W] and the stored energy [J] at the end of a step."""

    actuators: Array
    stored_rate: Array
    lost: Array
    given: Array
    """Power that the body gives to the water."""
    energy: Array
    """Kinetic and elastic energy."""

    @property
    def residual(self):
        """The part of the actuators' power that no other term contains."""
        return self.actuators - self.stored_rate - self.lost - self.given


def balance(x):
    c, s, integral, old = x.section(), x.mesh.structure, x.mesh.grid.integral, x.stage.reference
    strain_t = (c.strain - old.strain) / old.dt
    bend = [k * w for k, w in zip(s.stiffness, c.curvature, strict=True)]
    viscous = [k * w for k, w in zip(s.stiffness, c.curvature_t, strict=True)]
    spin = [j * w for j, w in zip(s.inertia, c.omega, strict=True)]
    load = total_load(x.stage.effects, c)
    stored = s.linear_density * dot(c.V, c.V.minus(old.V).times(1.0 / old.dt))
    stored += dot(spin, c.omega_t) + dot(bend, c.curvature_t) + s.EA * c.strain * strain_t
    lost = s.damping_time * (dot(viscous, c.curvature_t) + s.EA * strain_t**2)
    given = -(1.0 + c.strain) * (dot(load.force, c.V) + dot(load.couple, c.omega))
    energy = s.linear_density * dot(c.V, c.V) + dot(spin, c.omega)
    energy = 0.5 * (energy + dot(bend, c.curvature) + s.EA * c.strain**2)
    return Balance(x.actuator_power(), *(integral(q) for q in (stored, lost, given, energy)))


@pytest.mark.slow
@pytest.mark.parametrize("with_tendon", [False, True])
def test_the_powers_balance_at_every_step(with_tendon):
    """The work of the actuators is stored, dissipated or given to the water, to 1e-9 of the power.
    The body bends alike in both planes, and twists."""
    model = replace(strip_swimmer(EI_n=0.02), space=SpaceSettings(jnp.array([0.7, -0.7])))
    if with_tendon:
        pull = SineWave(3.0, 2e-3)
        helix = LengthTendon(0.02, 0.3, 0.012, pull, 2e3, angle=(0.3, 2.0))
        model = replace(model, actuators=(arrays(helix),))
    numerics = replace(SMALL, tolerance=1e-11)
    save = lambda x: (balance(x), x.section().curvature.n)  # noqa: E731
    run = jax.jit(lambda m: spatial_rollout(m, TimeGrid(5e-3, 60), save, numerics))(model)
    powers, bent = run.saved
    assert run.ok and np.abs(bent).max() > 0.5
    np.testing.assert_allclose(powers.residual, 0.0, atol=1e-9 * np.abs(powers.actuators).max())


@pytest.mark.slow
def test_the_energy_of_a_stride_closes():
    """The work of a stride is stored, dissipated or given to the water, to 1e-5 of the work.

    One factorisation serves both stages of a step."""
    model = replace(strip_swimmer(EI_n=0.02), space=SpaceSettings(jnp.array([0.7, -0.7])))
    steps, numerics = 1600, Numerics(tail_cells=12, body_cells=36, tolerance=1e-10)
    times = TimeGrid.per_stride(4.8, steps, 2)
    run = jax.jit(lambda m: spatial_rollout(m, times, balance, numerics, checkpoint=False))(model)
    stride = jax.tree.map(lambda x: np.array(x)[steps - 1 :], run.saved)
    work, lost, given = (
        np.trapezoid(x, dx=float(times.h)) for x in (stride.actuators, stride.lost, stride.given)
    )
    assert run.ok and min(work, lost, given) > 0.01
    assert run.final.factorisations < 1.01 * times.steps
    stored = stride.energy[-1] - stride.energy[0]
    np.testing.assert_allclose(lost + given + stored, work, rtol=1e-5)


@pytest.mark.slow
def test_a_failed_robot_leaves_its_batch_unchanged():
    """A second robot with an absurd moment fails; series and gradient of the first stay."""
    numerics = replace(SMALL, max_newton=3)

    def tip(K_Q):
        model = strip_swimmer()
        model = eqx.tree_at(lambda m: m.robot.K_Q, model, K_Q)
        run = readings(model, 40, 0.05, numerics)
        return jnp.sum(run.saved[-1]), (run.ok, run.final.factorisations)

    sloped = jax.value_and_grad(tip, has_aux=True)
    usual = strip_swimmer().robot.K_Q
    (alone, (ok, count)), slope = jax.jit(sloped)(usual)
    (both, (oks, _)), slopes = jax.jit(jax.vmap(sloped))(jnp.stack([usual, 1e6 * usual]))
    assert ok and count < 1.1 * 40
    assert list(oks) == [True, False]
    np.testing.assert_allclose(both[0], alone, rtol=1e-12)
    np.testing.assert_allclose(slopes[0], slope, rtol=1e-9)


@pytest.mark.slow
def test_quaternions_keep_their_norm_over_100000_steps():
    """A free strip tumbles and bends about all axes without loss; the norms stay 1 to 1e-12."""
    model = spatial(swimmer(2.0, 0.0, support=Free(), effects=(), damping_time=0.0))
    numerics = Numerics(tail_cells=2, body_cells=4)
    begin = at_rest_in_space(model, numerics)
    spin, place = begin.memory.omega, begin.memory.V
    tumbling = Vec(2.0 + 0.0 * spin[0], 1.0 + 0.0 * spin[0], 0.5 + 0.0 * spin[0])
    arm = jnp.linspace(-L, 0.0, place.shape[1])
    V = jnp.stack(tumbling.cross(Vec(arm, 0.0 * arm, 0.0 * arm)))
    begin = moving(begin, V, jnp.stack(tumbling))

    def save(x):
        return jnp.linalg.norm(x.frame, axis=0), x.frame[:, 0], jnp.abs(x.section().curvature.b)

    @jax.jit
    def run(begin):
        times = TimeGrid(0.005, 100_000)
        return spatial_rollout(model, times, save, numerics, begin=begin, checkpoint=False)

    found = run(begin)
    norms, frames, bent = (np.array(x) for x in found.saved)
    assert found.ok
    np.testing.assert_allclose(norms, 1.0, rtol=0, atol=1e-12)
    assert np.ptp(frames[-2000:], axis=0).min() > 0.5 and bent.max() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("what", ["time", "space"])
def test_order_in_time_and_in_space_is_two(what):
    runs = []
    model = strip_swimmer()
    for n in (10, 20, 40, 80):
        numerics = SMALL if what == "time" else Numerics(tail_cells=n // 5, body_cells=4 * n // 5)
        steps = 4 * n if what == "time" else 160
        found = jax.jit(lambda m: readings(m, steps, 0.2, numerics))(model)  # noqa: B023
        assert found.ok
        runs.append(np.array(found.saved)[steps // 40 - 1 :: steps // 40])
    size = np.sqrt(np.mean(runs[-1] ** 2, axis=0)).reshape(3, 3).max(axis=1).repeat(3)
    pairs = itertools.pairwise(runs)
    error = [np.sqrt(np.mean((a - b) ** 2, axis=0)) / size for a, b in pairs]
    error = np.max(np.reshape(error, (3, 3, 3)), axis=2)
    slopes = [-order([1, 2, 4], column) for column in error.T]
    print(what, slopes, error[-1])
    np.testing.assert_allclose(slopes, 2.0, atol=0.3)


@pytest.mark.slow
def test_derivatives_agree_forward_in_reverse_and_by_differences():
    """By EI_b, EI_n, GJ, the chambers' angle and C_d: 1e-12, and 1e-6 against differences."""
    values = jnp.array([0.7, 2.0, 0.02, EI_N, GJ])

    def tip(x):
        model = strip_swimmer(x[0], x[1], x[2], EI_n=x[3], GJ=x[4])
        numerics = replace(SMALL, tolerance=1e-13)
        return jnp.sum(readings(model, 12, 0.06, numerics).saved[-1])

    forward = jax.jit(jax.jacfwd(tip))(values)
    backward = jax.jit(jax.grad(tip))(values)
    assert np.all(np.abs(forward) > 0.0)
    np.testing.assert_allclose(backward, forward, rtol=1e-11, atol=1e-12 * np.abs(forward).max())
    value = jax.jit(tip)
    for i in range(5):
        step = jnp.zeros(5).at[i].set(1e-4 * values[i])
        difference = (value(values + step) - value(values - step)) / (2 * step[i])
        assert difference == pytest.approx(float(forward[i]), rel=1e-6)


def test_what_is_defined_in_the_plane_only_is_refused():
    model = spatial(swimmer())
    times = TimeGrid(0.01, 1)
    with pytest.raises(ValueError, match="tail_stiffness, which are defined in the plane only"):
        wrong = replace(model, effects=(*model.effects, TailStiffness(0.1)))
        spatial_rollout(wrong, times, lambda x: x.t)
    with pytest.raises(ValueError, match="GJ of body or tail is absent"):
        bare = replace(model, robot=model.robot.with_parts(lambda p: replace(p, GJ=None)))
        spatial_rollout(bare, times, lambda x: x.t)
    with pytest.raises(ValueError, match="Model.space is None"):
        spatial_rollout(swimmer(), times, lambda x: x.t)
    with pytest.raises(InputError, match="dimension: given 3; allowed 2"):
        rollout(model, times, lambda x: x.t)
    bare = model.robot.with_parts(lambda p: replace(p, polar_inertia=None))
    with pytest.raises(ValueError, match="polar_inertia of body or tail is absent"):
        spatial_rollout(replace(model, robot=bare), times, lambda x: x.t)


def test_rotation_vectors_and_quaternions_belong_together():
    v = np.random.default_rng(5).normal(size=(3, 50))
    v = jnp.asarray(v / np.linalg.norm(v, axis=0) * np.linspace(0.0, 2.0, 50))
    q = turned(Vec(*v))
    np.testing.assert_allclose(jnp.stack(rotation_vector(q)), v, atol=1e-14)
    np.testing.assert_allclose(sum(c**2 for c in q), 1.0, atol=1e-15)
    rate = Vec(*jnp.asarray(np.random.default_rng(6).normal(size=(3, 50))))
    omega = turning_of(Vec(*v), rate)
    np.testing.assert_allclose(jnp.stack(rate_of(Vec(*v), omega)), jnp.stack(rate), atol=1e-12)
    # The rate of a quaternion is q (0, omega)/2.
    _, q_t = jax.jvp(turned, (Vec(*v),), (rate,))
    product = q.after(type(q)(0.0 * q.w, *omega))
    np.testing.assert_allclose(jnp.stack(q_t), 0.5 * jnp.stack(product), atol=1e-14)
