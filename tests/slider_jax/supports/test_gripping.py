"""Tests of the spines (stick, slip, pull-off, energy) and of a robot whose link grips a wall."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.clock import Clock
from slider_jax.beam.parameters import G
from slider_jax.beam.state import fields
from slider_jax.dynamics.residual import turning_rate
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import at_rest, with_motion
from slider_jax.dynamics.time_schemes import BACKWARD_EULER, SDIRK2
from slider_jax.effects import Gravity
from slider_jax.supports import Free, GrippingLink, PinnedLink, Spines
from slider_jax.supports.gripping import FREE, HOLDING, LOST, ROUNDING
from tests.support.helpers import SMALL, arrays, swimmer

CAP, LINK = 172.3e3, 0.03


def drag(spines, velocities, dt=1e-3):
    """Forces and stretches (n, 2) of spines whose end moves with the `velocities` (n, 2)."""

    def body(stretch, v):
        force, stretch = spines.after(stretch, v, dt)
        return stretch, (force, stretch)

    return map(np.asarray, jax.lax.scan(body, jnp.zeros(2), jnp.asarray(velocities))[1])


def test_spines_stick_below_the_limit_and_slip_at_the_limit():
    """Dragged at 10 mm/s along an oblique line: k z + c v, and then mu N in this direction."""
    spines, v = Spines(4000.0, 8.0, 2.0, 5.0), 0.01 * np.array([0.6, -0.8])
    force, stretch = drag(spines, np.tile(v, (400, 1)))
    size = np.linalg.norm(force, axis=1)
    elastic = 4000.0 * 0.01 * 1e-3 * np.arange(1, 401) + 8.0 * 0.01
    sticks = elastic < (1.0 - ROUNDING) * 10.0
    np.testing.assert_allclose(size[sticks], elastic[sticks], rtol=1e-12)
    slips = elastic > (1.0 + ROUNDING) * 10.0
    assert sticks.sum() > 200 and slips.sum() > 100
    np.testing.assert_allclose(size[slips][50:], 10.0, rtol=1e-6)
    np.testing.assert_allclose(force[slips], size[slips, None] * [0.6, -0.8], rtol=1e-12)
    # The grip point follows the end: the stretch does not grow.
    np.testing.assert_allclose(np.linalg.norm(stretch[-1]), 10.0 / 4000.0, rtol=1e-3)


def test_below_the_limit_nothing_slips_however_long_the_load_lasts():
    spines = Spines(4000.0, 8.0, 2.0, 5.0)
    path = np.zeros((5000, 2))
    path[:20, 0] = 0.98 * 10.0 / 4000.0 / 0.02  # to 98 % of the limit, in 20 ms
    force, stretch = drag(dataclasses.replace(spines, damping=0.0), path)
    np.testing.assert_allclose(force[20:, 0], 9.8, rtol=1e-12)
    np.testing.assert_allclose(stretch[20:, 0], 9.8 / 4000.0, rtol=1e-12)


@pytest.mark.parametrize("damping", [0.0, 8.0])
def test_spines_give_no_energy(damping):
    """Random motion with slip in all directions: work >= gain of k z^2/2 in every step."""
    spines = Spines(4000.0, damping, 1.5, 2.0)
    v = np.cumsum(np.random.default_rng(0).normal(size=(4000, 2)), axis=0) * 0.005
    force, stretch = drag(spines, v)
    work = np.sum(force * v, axis=1) * 1e-3
    energy = 0.5 * 4000.0 * np.sum(stretch**2, axis=1)
    lost = work - np.diff(np.concatenate([[0.0], energy]))
    print(f"work {np.abs(work).sum():.3f} J, least loss in a step {lost.min():.1e} J")
    assert np.linalg.norm(force, axis=1).max() <= 3.0 * (1.0 + 1e-12)
    assert lost.sum() > 0.5 * np.abs(work).sum()
    assert lost.min() > -1e-12 * np.abs(work).sum()


def gripper(spines=None, frequency=2.0, amplitude=CAP, phase=0.0, effects=None, **link):
    clock = Clock(jnp.array([0.0]), jnp.array([float(frequency)]))
    support = GrippingLink(spines or Spines(), clock, LINK, phase, **({"wall_from": -100.0} | link))
    effects = (Gravity(G),) if effects is None else effects
    return swimmer(frequency, amplitude, support=arrays(support), effects=effects)


def hanging_from(model, angle=-np.arctan2(0.015, 0.18)):
    return with_motion(at_rest(model, SMALL), lambda motion: motion.at[..., 2, :].add(angle))


def contact(x):
    """Power [W] and stored energy [J] of the grips, and their state."""
    head = fields(x.y[:, -1])
    support, omega = x.stage.support, turning_rate(fields(x.y[:, -1]), x.stage)
    forces, after = support.grips(head, omega)
    velocity = jnp.stack(
        [
            jnp.stack([jnp.cos(head.phi) * v - jnp.sin(head.phi) * head.V_n,
                       jnp.sin(head.phi) * v + jnp.cos(head.phi) * head.V_n])
            for v in head.V_tau - support.arms() * omega
        ]
    )  # fmt: skip
    energy = 0.5 * support.spines.stiffness * jnp.sum(after.stretch**2)
    return -jnp.sum(forces * velocity), energy, after.status, after.load, x.head, head.phi


@eqx.filter_jit
def run(model, begin, h, steps, save=contact, scheme=SDIRK2):
    return rollout(model, TimeGrid(h, steps), save, SMALL, scheme, begin=begin, checkpoint=False)


@pytest.mark.parametrize("scheme", [BACKWARD_EULER, SDIRK2])
def test_a_climbing_robot_gains_no_energy_from_its_grips(scheme):
    """Weak spines that slip: the work on them is at least the energy that they store."""
    spines = Spines(4000.0, 8.0, 0.5, 5.0)
    model = gripper(spines)
    out = run(model, hanging_from(model), 1e-3, 3000, scheme=scheme)
    power, energy, status, load, *_ = map(np.asarray, out.saved)
    # When a grip is released, its stored energy is lost.
    released = (status[:-1] == HOLDING) & (status[1:] != HOLDING)
    work = np.cumsum(power) * 1e-3
    gained = energy - work
    print(
        f"{released.sum()} releases, loads up to {load.max():.2f} N, work {work[-1]:.4f} J, "
        f"largest gain {gained.max():.1e} J"
    )
    assert bool(out.ok) and released.sum() >= 10 and load.max() > 2.4
    assert work[-1] > 1e-3
    assert gained.max() < 1e-6 * np.abs(power).sum() * 1e-3


def test_a_grip_is_lost_at_the_pull_off_force_until_the_next_command():
    model = gripper(Spines(4000.0, 8.0, 2.0, 5.0, 3.0), frequency=0.5, amplitude=0.0)
    out = run(model, hanging_from(model, 0.5), 1e-3, 2500)
    _, _, status, load, head, _ = map(np.asarray, out.saved)
    left, right = status.T
    lost = np.argmax(left == LOST)
    print(f"lost after {lost} ms at {load[lost - 1, 0]:.3f} N")
    assert bool(out.ok) and 0 < lost < 999
    assert load[lost - 1, 0] > 3.0 and np.all(load[: lost - 1] <= 3.0)
    assert np.all(left[lost:999] == LOST) and np.all(load[lost:999] == 0.0)
    assert np.all(left[1001:1999] == FREE)
    assert np.any(right[998:1003] == HOLDING) and np.any(left[1998:2003] == HOLDING)
    # In between, the robot falls freely.
    assert head[lost + 200, 0] - head[lost, 0] < -0.1


def test_a_stiff_grip_climbs_like_a_pinned_link():
    """Rise in ten strides, and the angle of the head at the end of each."""
    stiff = Spines(4e5, 400.0, 100.0, 100.0, 1e6)
    gripping = gripper(stiff, phase=0.8)
    pinned = dataclasses.replace(gripping, support=arrays(PinnedLink(LINK, 2.0, 0.8)))

    def place(x):
        return x.head, x.y[5, -1]

    start = 0.8 / 2.0  # the left end is pinned at the pin phase
    found = []
    for model in (gripping, pinned):
        grid = TimeGrid(1e-3, 5000, start)
        begin = hanging_from(model)
        out = eqx.filter_jit(rollout)(model, grid, place, SMALL, begin=begin, checkpoint=False)
        assert bool(out.ok)
        head, angle = map(np.asarray, out.saved)
        found.append((head[499::500, 0] - head[0, 0], angle[499::500]))
    print(np.round(1e3 * np.array([x[0] for x in found]), 2))
    assert abs(found[1][0][-1]) > 0.02
    np.testing.assert_allclose(found[0][0], found[1][0], atol=0.02 * abs(found[1][0][-1]))
    np.testing.assert_allclose(found[0][1], found[1][1], atol=0.05)


def test_beside_the_wall_the_head_is_free():
    away, free = gripper(wall_from=5.0), gripper()
    free = dataclasses.replace(free, support=arrays(Free()))
    a, b = (run(m, hanging_from(m), 1e-3, 200, lambda x: (x.y, x.head)) for m in (away, free))
    np.testing.assert_allclose(a.saved[0], b.saved[0], atol=1e-9)
    np.testing.assert_allclose(a.saved[1], b.saved[1], atol=1e-9)


def test_an_end_grips_when_it_reaches_the_wall():
    model = gripper(wall_from=0.1, speed=1.6, amplitude=0.0, frequency=1.0)
    out = run(model, at_rest(model, SMALL), 1e-3, 200)
    _, _, status, _, head, _ = map(np.asarray, out.saved)
    first = np.argmax(status[:, 0] == HOLDING)
    assert bool(out.ok) and 10 < first < 200
    assert head[first - 1, 0] >= 0.1 > head[first - 2, 0]
    np.testing.assert_array_equal(status[:, 1], FREE)


def test_gradient_through_contact_is_that_of_differences():
    """Height after a slip, by stiffness, friction and pressure, with all changes between steps."""
    base = gripper(Spines(3000.0, 8.0, 0.55, 5.0))

    @jax.jit
    def end(x):
        spines = Spines(x[0], 8.0, x[1], 5.0)
        model = eqx.tree_at(lambda m: m.support.spines, base, arrays(spines))
        model = eqx.tree_at(
            lambda m: [w.amplitude for w in m.drive.waves], model, [x[2] * CAP, x[2] * CAP]
        )
        out = rollout(model, TimeGrid(1e-3, 400), contact, SMALL, begin=hanging_from(model, 0.3))
        return out.final.memory.head[0] + 0.1 * out.final.memory.head[1], jnp.max(out.saved[3])

    at = jnp.array([3000.0, 0.55, 1.0])
    found, most = jax.jacrev(end)(at)[0], end(at)[1]
    steps = np.array([1e-2, 1e-6, 1e-6])
    differences = [
        float(end(at.at[i].add(d))[0] - end(at.at[i].add(-d))[0]) / (2.0 * d)
        for i, d in enumerate(steps)
    ]
    print(found, differences, most)
    assert most > 0.99 * 0.55 * 5.0  # it slips
    np.testing.assert_allclose(found, differences, rtol=1e-4)
