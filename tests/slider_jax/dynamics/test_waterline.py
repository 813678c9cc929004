"""Tests of a body that pierces the water's surface: buoyancy, forces of the wet part, energy."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation import FirstOrderLag, SineWave
from slider_jax.beam.parameters import Numerics, uniform_robot
from slider_jax.beam.state import to_plane
from slider_jax.beam.waterline import Waterline
from slider_jax.dynamics.model import Drive, Model, SpaceSettings
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.statics import Loads, at_rest_under
from slider_jax.dynamics.step import Snapshot, at_rest, with_motion
from slider_jax.effects import Gravity, NormalDrag, ReactiveForce, total_force
from slider_jax.effects.base import force_of
from slider_jax.effects.water.linear_friction import LinearFriction
from slider_jax.effects.water.tangential_friction import TangentialFriction
from slider_jax.errors import InputError
from slider_jax.observables import stored_energy
from slider_jax.supports import Clamped, Free
from tests.support.energy_balance import energy_rates
from tests.support.helpers import arrays, swimmer

G, WATER, LENGTH, MASS = 9.81, 1000.0, 0.368, 0.7
MESH = Numerics(tail_cells=6, body_cells=24)


def floater(level, density=2.0 * WATER / 3.0, *, support=None, effects=(), thickness=0.03, **robot):
    """A stiff passive rod with weight and buoyancy; x points up, and the head starts at x = 0."""
    stiff = {"EI_body": 38.0, "EI_tail": 38.0, "damping_time": 0.002, "K_Q": 0.0}
    body = uniform_robot(**(stiff | robot)).with_parts(
        lambda part: dataclasses.replace(part, area=MASS / density)
    )
    model = Model(
        body,
        (Gravity(G, density=WATER), *effects),
        FirstOrderLag(0.1),
        Drive((SineWave(1.0, 0.0), SineWave(1.0, 0.0))),
        Free() if support is None else support,
        waterline=Waterline(level, 0.0, thickness),
    )
    return arrays(model)


def turned(model, angle, numerics=MESH):
    carry = at_rest(model, numerics)
    return with_motion(carry, lambda motion: motion.at[..., 2, :].add(angle))


def forces(x: Snapshot):
    section, grid = x.section(), x.mesh.grid

    def of(effect):
        F = jnp.stack(to_plane(*force_of(effect, section), section.phi))
        return grid.integral((1.0 + section.strain) * F)

    return jnp.stack([of(e) for e in x.stage.effects])


@eqx.filter_jit
def fall(model, begin, h, steps, save, numerics=MESH):
    return rollout(model, TimeGrid(h, steps), save, numerics, begin=begin, checkpoint=False)


def test_a_floating_spar_displaces_its_weight():
    """At rest upright, 2/3 of the spar is wet: the net force vanishes and the head is 1/3 L up."""
    damping = (LinearFriction(3.0),)
    model = floater(-0.3 * LENGTH, effects=damping)

    def save(x):
        return forces(x)[0], x.section().wet, x.head[0], x.positions()[0, 0]

    run = fall(model, at_rest(model, MESH), 0.01, 3000, save)
    net, wet, head, tip = (np.asarray(v)[-1] for v in run.saved)
    weight = MASS * LENGTH * G
    s = np.asarray(run.mesh.grid.ds)
    displaced = WATER * G * (MASS / (2.0 * WATER / 3.0)) * (wet * s).sum()
    print(f"net force {net[0]:.2e} N of {weight:.3f} N; wet {(wet * s).sum() / LENGTH:.8f}")
    assert bool(run.ok) and abs(head - tip - LENGTH) < 1e-4
    assert abs(displaced - weight) < 1e-6 * weight
    # Independently of the wet fraction: the length below the surface.
    assert abs((-0.3 * LENGTH - tip) - 2.0 / 3.0 * LENGTH) < 1e-4 * LENGTH
    assert abs(net[0]) < 1e-4 * weight


def test_buoyancy_of_a_partly_immersed_body_is_the_weight_of_the_displaced_water():
    """Held at any inclination, by the geometry of the straight body."""
    for angle, share in ((0.0, 0.25), (0.9, 0.5), (2.4, 0.6)):
        level = -share * LENGTH * np.cos(angle)
        model = floater(level, support=Clamped())
        run = fall(model, turned(model, angle), 1e-4, 1, lambda x: forces(x)[0])
        dry = MASS * LENGTH * G
        wet = 1.0 - share if np.cos(angle) > 0 else share
        displaced = wet * LENGTH * (MASS / (2.0 * WATER / 3.0)) * WATER * G
        assert bool(run.ok)
        np.testing.assert_allclose(run.saved[0, 0] + dry, displaced, rtol=1e-6)


def test_the_force_of_the_water_on_a_half_wet_body_is_the_integral_over_the_wet_part():
    """A rigid body heaves across itself: the sum over the cells below the surface is the force.

    The sharp edge of the wet part cuts a cell, in which the force per length is uniform.
    """
    support = Clamped(0.0, heave=0.05, frequency=1.5)
    effects = (NormalDrag(3.0), ReactiveForce(1.0), TangentialFriction(0.05))
    model = floater(-0.5 * LENGTH, support=support, effects=effects, thickness=1e-3, EI_body=3e4,
                    EI_tail=3e4)  # fmt: skip

    def save(x):
        section, water = x.section(), x.stage.effects[1:]
        everywhere = dataclasses.replace(section, wet=None)
        return jnp.stack(total_force(water, section)), jnp.stack(total_force(water, everywhere))

    half = fall(model, at_rest(model, MESH), 2e-3, 100, save)
    ds, s = np.asarray(half.mesh.grid.ds), np.asarray(half.mesh.grid.s)
    covered = np.clip((0.5 * LENGTH - s[:-1]) / ds, 0.0, 1.0)  # the exact wet part of each cell
    of_half, of_wet = (np.sum(F * share * ds, axis=-1)[20:] for F, share in
                       zip(map(np.asarray, half.saved), (1.0, covered), strict=True))  # fmt: skip
    size = np.abs(of_wet).max()
    print(f"largest force {size:.3f} N, difference {np.abs(of_half - of_wet).max():.1e} N")
    assert size > 0.1
    assert np.abs(of_half - of_wet).max() < 1e-6 * size


def balance(x: Snapshot):
    """Energies [J] of body, weight, buoyancy and added mass, and powers [W] that are lost."""
    section, grid = x.section(), x.mesh.grid
    gravity, reactive, drag = x.stage.effects
    nodes = x.positions()
    height = grid.mid(nodes[0])
    m_A = reactive.added_mass(section.height)
    # The integral of the wet fraction over the depth of a level section.
    depth = (LEVEL - height) / THICKNESS
    c = jnp.clip(depth, -0.5, 0.5)
    dip = 0.09375 + 0.5 * c + 0.75 * c**2 - 0.5 * c**4 + jnp.maximum(depth - 0.5, 0.0)
    lift = gravity.density * section.area * gravity.g * THICKNESS * dip
    weight = section.linear_density * gravity.g * height
    kinetic = 0.5 * m_A * section.wet * section.u_n**2
    stretch = 1.0 + section.strain
    lost = 0.5 * m_A * jnp.abs(section.wetting) * section.u_n**2
    lost = lost - section.wet * drag.force(section)[1] * section.V_n * stretch
    rates = energy_rates(x)
    own = stored_energy(x).total + grid.integral(weight + lift + kinetic)
    return own, grid.integral(lost) + rates.dissipated, x.head[0], section.wet[0]


LEVEL, THICKNESS = -0.12, 0.03


def test_energy_of_entry_and_exit_closes():
    """A level rod falls flat into the water and bobs out again; kinetic, potential and lost energy.

    In the added mass, the water takes m_A u_n^2/2 and the spray the same again; on exit, the water
    keeps its energy.
    """
    effects = (ReactiveForce(0.5), NormalDrag(1.0))
    h = 5e-4
    model = floater(LEVEL, 300.0, effects=effects, thickness=THICKNESS)
    run = fall(model, turned(model, 0.5 * np.pi), h, round(1.0 / h), balance)
    own, lost, head, wet = map(np.asarray, run.saved)
    at = np.asarray(run.t)
    lost = np.concatenate([[0.0], np.cumsum(0.5 * (lost[1:] + lost[:-1]) * np.diff(at))])
    total = own + lost
    scale = MASS * LENGTH * G * 0.12
    crossings = np.count_nonzero(np.diff(wet > 0.5))
    print(
        f"fell to {head.min():.3f} m, {crossings} crossings, lost {lost[-1] / scale:.2f} of the "
        f"fall, error {np.abs(total - total[0]).max() / scale:.1e}"
    )
    assert bool(run.ok) and crossings >= 2 and wet.max() > 0.99 and wet[-1] < 1.0
    assert lost[-1] > 0.1 * scale
    assert np.abs(total - total[0]).max() < 1e-3 * scale


def test_gradient_through_the_surface_is_that_of_differences():
    """Place of a flexible rod after its dive, by the level, the stiffness and the added mass."""
    effects = (ReactiveForce(0.8), NormalDrag(2.0))
    base = floater(-0.05, 700.0, effects=effects, EI_body=0.038, EI_tail=0.006)
    small = Numerics(tail_cells=3, body_cells=8)

    @jax.jit
    def end(x):
        model = dataclasses.replace(base, waterline=Waterline(x[0], 0.0, 0.03))
        model = eqx.tree_at(lambda m: (m.robot.body.EI, m.effects[1].m_a), model, (x[1], x[2]))
        begin = turned(model, 1.1, small)
        run = rollout(model, TimeGrid(2e-3, 150), lambda s: s.head, small, begin=begin)
        return run.final.memory.head[0] + 0.3 * run.final.memory.head[1]

    at = jnp.array([-0.05, 0.038, 0.8])
    found = np.asarray(jax.grad(end)(at))
    steps = np.array([1e-6, 1e-6, 1e-5])
    differences = [
        float(end(at.at[i].add(d)) - end(at.at[i].add(-d))) / (2.0 * d) for i, d in enumerate(steps)
    ]
    print(found, differences)
    assert np.abs(found).min() > 0.0
    np.testing.assert_allclose(found, differences, rtol=1e-4)


def test_a_deep_waterline_changes_nothing_but_rounding():
    plain = swimmer(support=Free())
    deep = dataclasses.replace(plain, waterline=arrays(Waterline(5.0, 0.0)))
    a, b = (fall(m, at_rest(m, MESH), 2e-3, 50, lambda x: x.y) for m in (plain, deep))
    np.testing.assert_allclose(a.saved, b.saved, rtol=1e-9, atol=1e-11)


def test_a_waterline_is_planar():
    model = dataclasses.replace(swimmer(), waterline=Waterline(0.0))
    with pytest.raises(InputError, match="dimension"):
        dataclasses.replace(model, space=SpaceSettings(jnp.zeros(2)))
    with pytest.raises(InputError, match="static"):
        at_rest_under(model, Loads(jnp.zeros(2), jnp.zeros(2)))


def test_a_rod_that_dives_and_turns_gives_the_water_its_energy_spray_and_wake():
    """Power on the water = d(energy of the added mass)/dt + |r| m_A u_n^2/2 + flux to the wake.

    The rod dives obliquely and turns. Lighthill's identity holds for the wet part only with the
    force of entry; the error decreases with the cells and the step.
    """
    model = floater(-0.1, 600.0, effects=(ReactiveForce(0.5),), thickness=0.06)
    fine = Numerics(tail_cells=16, body_cells=64)

    def save(x):
        section, grid = x.section(), x.mesh.grid
        reactive = x.stage.effects[1]
        F_tau, F_n = force_of(reactive, section)
        given = -grid.integral((1.0 + section.strain) * (F_tau * section.V_tau + F_n * section.V_n))
        E = 0.5 * reactive.added_mass(section.height) * section.u_n**2
        wet = section.wet * E
        spray = grid.integral(E * jnp.abs(section.wetting))
        wake = section.u_tau[0] * wet[0] - section.u_tau[-1] * wet[-1]
        return given, grid.integral(wet), spray, wake, section.phi[0], section.wet

    h = 5e-4
    run = fall(model, turned(model, 0.7, fine), h, 800, save, fine)
    given, kinetic, spray, wake, angle, wet = map(np.asarray, run.saved)
    rates = np.array([np.trapezoid(x, dx=h) for x in (given, spray, wake)])
    scale = np.trapezoid(np.abs(given), dx=h)
    off = rates[0] - (kinetic[-1] - kinetic[0]) - rates[1] - rates[2]
    print(f"turned by {np.ptp(angle):.2f} rad, wet {wet.mean(axis=1).max():.2f}; given, spray, "
          f"wake {rates}, error {off / scale:.1e}")  # fmt: skip
    assert bool(run.ok) and np.ptp(angle) > 0.3 and wet.mean(axis=1).max() > 0.5
    assert min(rates[1], abs(rates[2])) > 0.03 * scale
    assert abs(off) < 3e-3 * scale
