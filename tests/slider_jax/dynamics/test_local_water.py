"""A body in nonuniform water, against closed forms, balances and independent quadrature."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax import observables as obs
from slider_jax.actuation import SineWave
from slider_jax.beam.parameters import Numerics
from slider_jax.beam.state import fields, to_plane
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.effects import NormalDrag, ReactiveForce, total_force
from slider_jax.effects.water.head_drag import HeadDrag
from slider_jax.effects.water.tank_current import TankCurrent
from slider_jax.supports import Clamped, Free
from slider_jax.water import VortexStreet, WaterField, karman_speed
from slider_jax.water.gridded import gridded
from tests.support.energy_balance import energy_rates
from tests.support.helpers import SMALL, arrays, march, order, swimmer, uniform

STREAM, A, GAMMA, CORE = 0.3, 0.25, 0.04, 0.02
SPEED = -STREAM + float(karman_speed(A, GAMMA))
F = -SPEED / A
"""Frequency [Hz] at which vortices of a row pass a fixed point."""
HEIGHT, RHO, C_D = 0.03, 1000.0, 2.0
M_A = np.pi * RHO * HEIGHT**2 / 4.0


def street(x=0.0, y=0.0, circulation=GAMMA):
    return VortexStreet(A, circulation, CORE, (-STREAM, 0.0), SPEED, (x, y))


def within(model, water):
    return arrays(dataclasses.replace(model, water=water))


class Linear(WaterField):
    """U = `offset` + `slopes` r."""

    offset: jax.Array
    slopes: jax.Array

    def velocity(self, place, t):
        return self.offset + self.slopes @ place


def on_clamp(x):
    """Returns the force (x, y) [N] of the body on the clamp, and the moment M [N m] at the head."""
    head = fields(x.y[:, -1])
    return jnp.stack([*to_plane(-head.T, -head.N, head.phi), head.M])


class _Motion(eqx.Module):
    """Saves the midline and all unknowns; runs with different steps share a compiled program."""

    def __call__(self, x):
        return jnp.concatenate([obs.midline(x).ravel(), x.y.ravel()])


# A uniform flow given in three ways.


TOWED = Clamped(tow_speed=0.1, heave=0.01, frequency=4.8)


@pytest.mark.parametrize("support", [Free(), pytest.param(TOWED, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_uniform_water_as_function_or_grid_is_uniform_water(support):
    """With a current as an effect in addition. Tolerance 1e-8 of the largest value."""
    U, x = jnp.array([-0.35, 0.08]), np.linspace(-2.0, 2.0, 5)
    one = np.ones((3, 5, 5))
    grid = gridded(np.array([-1.0, 0.0, 1.0]), x, x, -0.35 * one, 0.08 * one)
    found = []
    for water in (U, Linear(U, jnp.zeros((2, 2))), grid):
        model = within(swimmer(support=support, wave=SineWave), water)
        model = dataclasses.replace(model, effects=(*model.effects, TankCurrent(0.05, 0.02)))
        found.append(march(arrays(model), 2e-3, 60, _Motion(), SMALL, chunk=60)[1])
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=0.0, atol=1e-8 * np.abs(found[0]).max())


@pytest.mark.parametrize("support", [Free(), pytest.param(TOWED, marks=pytest.mark.slow)])
def test_still_water_is_water_with_the_velocity_zero(support):
    """Motion, and its derivative with respect to the drag. Tolerance 1e-10 of the largest value."""
    times = TimeGrid(2e-3, 30)

    def run(water, *effects):
        def moved(C_d):
            model = within(swimmer(support=support, wave=SineWave, C_d=C_d), water)
            model = dataclasses.replace(model, effects=(*model.effects, *effects))
            return rollout(model, times, _Motion(), SMALL, checkpoint=False).saved

        return jax.jit(lambda C_d: jax.jvp(moved, (C_d,), (jnp.ones_like(C_d),)))(jnp.asarray(3.0))

    def close(found, exact):
        for a, b in zip(found, exact, strict=True):
            np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-10 * np.abs(b).max())

    close(run(None), run((0.0, 0.0)))
    current, stream = run(None, TankCurrent(0.05, 0.02)), run((0.05, 0.02))
    close(current, stream)
    assert np.abs(current[0] - run(None)[0]).max() > 1e-3


# Closed forms.

G = [[[1.2, 0.0], [0.0, -1.2]], [[0.0, 1.5], [0.0, 0.0]], [[0.7, -0.4], [2.0, -0.7]]]


@pytest.mark.slow
def test_a_rigid_towed_body_in_shear_and_strain_has_the_force_of_potential_flow():
    """F_n = m_A n . (U_tau dU/dtau + V_n dU/dn), F_tau = 0. Tolerance 1e-3 of force and moment.

    For a strip this force follows from the jump of the unsteady Bernoulli pressure across it.
    """
    L, tow, angle, offset = 0.2, 0.2, 0.35, np.array([-0.25, 0.15])

    def save(x):
        at = x.section()
        return on_clamp(x), x.head, x.stage.effects[0].force(at)[0]

    def last(slopes, C_d):
        support = Clamped(tow_speed=tow, pitch=angle, pitch_phase=0.5 * np.pi)
        effects = (ReactiveForce(1.0), NormalDrag(C_d))
        model = uniform(L=L, EI=100.0, effects=effects, support=support, damping_time=0.02)
        model = eqx.tree_at(lambda m: m.effects[1].C_d, model, C_d)
        model = dataclasses.replace(model, water=Linear(jnp.asarray(offset), slopes))
        out = rollout(model, TimeGrid(2e-3, 150), save, Numerics(tail_cells=8, body_cells=32))
        return jax.tree.map(lambda x: x[-1], out.saved)

    d = (np.arange(2000) + 0.5) * L / 2000
    tau = np.array([np.cos(angle), np.sin(angle)])
    n = np.array([-tau[1], tau[0]])
    both = jax.jit(jax.vmap(jax.vmap(last, (None, 0)), (0, None)))
    force, heads, along = both(jnp.asarray(G), jnp.array([0.0, C_D]))
    for i, slopes in enumerate(np.asarray(G)):
        U = offset + (heads[i, 0] - d[:, None] * tau) @ slopes.T
        V_n = tow * n[0]
        F_n = M_A * ((U @ tau) * (n @ slopes @ tau) + V_n * (n @ slopes @ n))
        u_n = V_n - U @ n
        for j, C_d in enumerate((0.0, C_D)):
            total = F_n - 0.5 * RHO * C_d * HEIGHT * np.abs(u_n) * u_n
            expected = np.array([*(total.mean() * L * n), (d * total).mean() * L])
            scale = np.abs(total).mean() * L * np.array([1.0, 1.0, L])
            error = np.abs(force[i, j] - expected) / scale
            print(f"G {i}, C_d {C_d}: force {expected}, relative error {error}")
            assert error.max() < 1e-3
            assert np.abs(along[i, j]).max() < 1e-4 * np.abs(F_n).max()


@pytest.mark.slow
def test_a_head_drafts_between_the_rows_and_not_beside_them():
    """The mean drag of the head is that of the local speed. Tolerance 1e-3."""
    area, steps, places = 1e-3, 100, jnp.array([0.0, 0.6])

    def save(x):
        return on_clamp(x)[0], x.mesh.grid.mid(obs.midline(x))[:, -1]

    def run(y):
        model = uniform(EI=10.0, effects=(HeadDrag(area),), support=Clamped(), damping_time=0.01)
        model = dataclasses.replace(model, water=street(y=y))
        return rollout(model, TimeGrid(1.0 / (F * steps), 2 * steps), save, SMALL).saved

    drag, at = jax.jit(jax.vmap(run))(places)
    found = -np.asarray(drag)[:, steps:].mean(1)
    expected = []
    for y, place in zip(places, np.asarray(at)[:, -1], strict=True):
        t = jnp.arange(400.0) / (400.0 * F)
        U = jax.vmap(lambda t, y=y, p=place: street(y=y).velocity(jnp.asarray(p), t))(t)[:, 0]
        expected.append(float(jnp.mean(-jnp.abs(U) * U) * 0.5 * RHO * area))
    np.testing.assert_allclose(found, expected, rtol=1e-3)
    np.testing.assert_allclose(found[1], 0.5 * RHO * area * STREAM**2, rtol=1e-3)
    assert found[0] < 0.5 * found[1]


PITCH, FOIL = 0.3, 0.1
PHASES = np.arange(8) / 4.0 * np.pi


def foil_quadrature(phase, cells=64, times=400):
    """Returns the mean forward force [N] of a pitching foil, and the mean of angle times U_y.

    The velocities follow from the prescribed motion; their derivatives are central differences.
    """
    velocity = jax.jit(jax.vmap(street().velocity, (1, 0), 1))

    def relative(d, t):
        angle = PITCH * np.sin(2 * np.pi * F * t + phase)
        rate = PITCH * 2 * np.pi * F * np.cos(2 * np.pi * F * t + phase)
        place = -d * np.stack([np.cos(angle), np.sin(angle)])
        flat = jnp.asarray(place.reshape(2, -1)), jnp.asarray(t.ravel())
        U = np.asarray(velocity(*flat)).reshape(place.shape)
        u_tau = -U[0] * np.cos(angle) - U[1] * np.sin(angle)
        return u_tau, -d * rate + U[0] * np.sin(angle) - U[1] * np.cos(angle), angle, U[1]

    d, t = np.meshgrid((np.arange(cells) + 0.5) * FOIL / cells, np.arange(times) / (times * F))
    u_tau, u_n, angle, U_y = relative(d, t)
    e = 1e-5
    u_n_t = (relative(d, t + e)[1] - relative(d, t - e)[1]) / (2 * e)
    u_n_s = -(relative(d + e, t)[1] - relative(d - e, t)[1]) / (2 * e)
    F_n = -M_A * (u_n_t - u_tau * u_n_s) - 0.5 * RHO * C_D * HEIGHT * np.abs(u_n) * u_n
    return (-np.sin(angle) * F_n).mean() * FOIL, (angle * U_y).mean()


@pytest.mark.slow
def test_a_pitching_foil_in_a_street_has_thrust_or_drag_by_its_phase():
    """The mean force is that of an independent quadrature, within 2 % of its range.

    A foil that leans against the lateral flow (angle times U_y < 0) tacks upstream: its normal
    force has a forward component. A foil that leans with the flow is pushed back. Trout in a
    street use the first phase: Liao, J. C. et al. (2003), The Karman gait, J. Exp. Biol. 206,
    1059-1073; Beal, D. N. et al. (2006), Passive propulsion in vortex wakes, J. Fluid Mech. 549,
    385-402. Half of the range of the force must follow this sign.
    """
    steps = 150

    def run(phase):
        support = Clamped(pitch=PITCH, frequency=F, pitch_phase=phase)
        effects = (NormalDrag(C_D), ReactiveForce(1.0))
        model = uniform(L=FOIL, EI=10.0, effects=effects, support=support, damping_time=0.01)
        model = dataclasses.replace(model, water=arrays(street()))
        out = rollout(model, TimeGrid(1.0 / (F * steps), 2 * steps), on_clamp, SMALL)
        return out.saved[steps:, 0].mean()

    found = np.asarray(jax.jit(jax.vmap(run))(jnp.asarray(PHASES)))
    expected, leaning = np.transpose([foil_quadrature(phase) for phase in PHASES])
    print("phase, force, quadrature, angle x U_y:", np.stack([PHASES, found, expected, leaning]))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=0.02 * np.ptp(expected))
    against, with_flow = found[np.argmin(leaning)], found[np.argmax(leaning)]
    assert against > 0.0 > with_flow
    assert against - with_flow > 0.5 * np.ptp(found)
    assert np.corrcoef(found, leaning)[0, 1] < -0.8


@pytest.mark.slow
def test_a_passive_body_is_pulled_upstream_in_the_street_by_its_own_bending():
    """Mean thrust <M^2>/(2 EI) - m <V_tip^2>/2, for any normal force. Tolerance 5 %.

    In linear theory, -int y' F_n ds with F_n = EI y'''' + m d^2y/dt^2 is this sum, because the
    head is clamped and the tail is free.
    """
    steps, EI, beside = 150, 0.02, 0.6

    def save(x):
        return jnp.concatenate([on_clamp(x), x.y[4, :1]])

    def run(y):
        effects = (NormalDrag(C_D), ReactiveForce(1.0))
        model = uniform(L=0.2, EI=EI, effects=effects, damping_time=0.01)
        model = dataclasses.replace(model, water=arrays(street(y=y)))
        out = rollout(model, TimeGrid(1.0 / (F * steps), 4 * steps), save, SMALL)
        return out.saved[3 * steps :]

    inside, outside = np.asarray(jax.jit(jax.vmap(run))(jnp.array([0.0, beside])))
    M, V_tip = inside[:, 2], inside[:, 3]
    expected = np.mean(M**2) / (2.0 * EI) - 0.5 * 0.7 * np.mean(V_tip**2)
    print(f"thrust {inside[:, 0].mean():.3e} N, linear theory {expected:.3e} N")
    assert inside[:, 0].mean() > 0.0
    np.testing.assert_allclose(inside[:, 0].mean(), expected, rtol=0.05)
    assert abs(outside[:, 0].mean()) < 1e-3 * expected


# Balances of a driven, flexible body.

CELLS = Numerics(tail_cells=40, body_cells=160)
H, STEPS = 5e-4, 400


def budget(x):
    at, grid = x.section(), x.mesh.grid
    stretch = 1.0 + at.strain
    force = stretch * jnp.stack(to_plane(*total_force(x.stage.effects, at), at.phi))
    tangential, normal = x.stage.effects[1].force(at)
    reactive = stretch * jnp.stack(to_plane(tangential, normal, at.phi))
    V = jnp.stack(to_plane(at.V_tau, at.V_n, at.phi))
    return dict(
        momentum=grid.integral(at.linear_density * V),
        force=grid.integral(force) - on_clamp(x)[:2],
        exchanged=grid.integral(jnp.sqrt(jnp.sum(force**2, axis=0) + 1e-30)),
        reactive=grid.integral(reactive),
        reactive_power=grid.integral(jnp.sum(reactive * V, axis=0)),
        tangential=jnp.max(jnp.abs(tangential)) / jnp.max(jnp.abs(normal)),
        midline=obs.midline(x),
        rates=energy_rates(x),
    )


@pytest.fixture(
    scope="module",
    params=[pytest.param(Free(), marks=pytest.mark.slow), Clamped(heave=0.02, frequency=2.0)],
)
def swum(request):
    model = swimmer(
        frequency=2.0, wave=SineWave, C_d=C_D, support=request.param, EA_body=1e6, EA_tail=1e6
    )
    return march(within(model, street()), H, STEPS, budget, CELLS, chunk=STEPS)


def test_momentum_changes_by_the_forces_of_water_and_clamp(swum):
    """Tolerance 1e-3 of the exchanged momentum."""
    _, out = swum
    impulse = H * np.cumsum(0.5 * (out["force"][1:] + out["force"][:-1]), axis=0)
    gained = out["momentum"][1:] - out["momentum"][0]
    error = np.abs(gained - impulse).max() / (H * out["exchanged"].sum())
    print(f"error {error:.1e}")
    assert error < 1e-3


def test_power_balances_in_nonuniform_water(swum):
    rates = swum[1]["rates"]
    left = rates.put_in - rates.stored.total - rates.dissipated - rates.to_effects
    np.testing.assert_allclose(left, 0.0, atol=1e-8 * float(np.max(np.abs(rates.to_effects))))


def test_the_reactive_force_is_that_of_the_recorded_motion(swum):
    """Force and power from midlines and the field only; tolerance 1e-3 of the largest value.

    For a uniform height, the force is normal: F_n = -m_A (du_n/dt - u_tau du_n/ds - kappa u_n^2/2).
    """
    t, out = swum
    r = out["midline"]  # (steps, 2, nodes)
    mid, step = 0.5 * (r[..., 1:] + r[..., :-1]), r[..., 1:] - r[..., :-1]
    ds = np.linalg.norm(step, axis=1)
    tau = step / ds[:, None]
    n = np.stack([-tau[:, 1], tau[:, 0]], axis=1)
    V = np.gradient(mid, H, axis=0, edge_order=2)
    velocity = jax.jit(jax.vmap(jax.vmap(street().velocity, (1, None), 1)))
    u = V - np.asarray(velocity(jnp.asarray(mid), jnp.asarray(t)))
    u_tau, u_n = (u * tau).sum(1), (u * n).sum(1)
    s = np.cumsum(ds[0]) - 0.5 * ds[0]
    angle = np.unwrap(np.arctan2(tau[:, 1], tau[:, 0]), axis=1)
    slope = lambda q: np.gradient(q, s, axis=1, edge_order=2)  # noqa: E731
    u_n_t = np.gradient(u_n, H, axis=0, edge_order=2)
    F_n = -M_A * (u_n_t - u_tau * slope(u_n) - 0.5 * slope(angle) * u_n**2)
    force, power = ((F_n * ds)[:, None] * n).sum(2), (F_n * ds * (V * n).sum(1)).sum(1)
    late = slice(STEPS // 4, -4)  # after the start, without one-sided differences
    for name, mine in (("reactive", force), ("reactive_power", power)):
        error = np.abs(out[name] - mine)[late].max() / np.abs(mine[late]).max()
        print(f"{name}: error {error:.1e}")
        assert error < 1e-3
    assert out["tangential"][late].max() < 1e-3


# Numerics.


@pytest.mark.parametrize("support", [Clamped(pitch=0.2, frequency=1.0), Free()])
@pytest.mark.slow
def test_positions_keep_the_scheme_second_order(support):
    """Order of midline and motion at 0.32 s: at least 1.8."""
    drive = dict(frequency=2.0, amplitude=150e3, wave=SineWave, damping_time=0.002)
    model = within(swimmer(support=support, **drive), street())
    steps, ends = [4e-3, 2e-3, 1e-3, 2.5e-4], []
    for h in steps:
        end = march(model, h, round(0.32 / h), _Motion(), SMALL, chunk=80)[1][-1]
        ends.append(np.concatenate([end[: 2 * SMALL.nodes], end[-3 * SMALL.nodes :]]))
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    print(errors, order(steps[:-1], errors))
    assert order(steps[:-1], errors) > 1.8


@pytest.mark.slow
def test_forces_are_differentiable_with_respect_to_the_street():
    @jax.jit
    def impulse(circulation):
        model = within(swimmer(), street(circulation=circulation))
        return jnp.sum(rollout(model, TimeGrid(2e-3, 25), on_clamp, SMALL).saved[:, 1])

    at, e = jnp.asarray(GAMMA), 1e-5
    central = (impulse(at + e) - impulse(at - e)) / (2 * e)
    forward = jax.jvp(impulse, (at,), (jnp.ones(()),))[1]
    np.testing.assert_allclose(forward, central, rtol=1e-5)
    np.testing.assert_allclose(jax.grad(impulse)(at), forward, rtol=1e-9)
