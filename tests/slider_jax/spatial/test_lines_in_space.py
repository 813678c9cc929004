"""Tendons and chambers beside the axis: planar limit, rod at rest, Jacobian, derivatives, errors.

One compiled program serves the tests that simulate a small robot with three tendons.
"""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation import LengthTendon, SineWave, TensionTendon
from slider_jax.actuation.waveform import Recorded
from slider_jax.beam.spatial import SpatialReference, Vec, about_tau, turned
from slider_jax.dynamics.model import Drive, SpaceSettings, make_mesh
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.effects import NormalDrag, ReactiveForce
from slider_jax.rod.equilibrium import solve_equilibrium
from slider_jax.rod.loads import RodLoads, RodTendon
from slider_jax.rod.rod import Rod
from slider_jax.spatial.lines import chamber_lines, lines_of_chambers, tendon_lines
from slider_jax.spatial.mesh import spatial_mesh
from slider_jax.spatial.residual import (
    SpatialStage,
    means_and_slopes,
    spatial_jacobian,
    spatial_residual,
    tensions_in_space,
    turning_in_cells,
    vectors,
)
from slider_jax.spatial.step import at_rest_in_space, spatial_rollout
from tests.support.helpers import SMALL, arrays, swimmer

L, EI, EI_N, GJ, EA, K_Q = 0.368, 0.038, 0.06, 0.03, 4e3, 4.79e-7
CELLS = SMALL.tail_cells + SMALL.body_cells
NUM = replace(SMALL, tolerance=1e-10)
STEPS = 24
SLOW = 5.0
"""Time step [s] with which the robot comes to rest; the time scheme damps its motion."""


def ramp(value):
    """A command that grows from 0 to `value` in 10 steps of the slow robot, and then remains."""
    return Recorded(SLOW * jnp.array([0.0, 10.0, 30.0]), value * jnp.array([0.0, 1.0, 1.0]))


def robot(tendons, pressures, angles=((0.0, 0.0),) * 2, distances=(0.01, 0.01), C=(0.0, 0.0)):
    """A clamped robot with chambers and tendons; `C` are C_d and m_a of the water."""
    model = swimmer(
        effects=(NormalDrag(C[0]), ReactiveForce(C[1])), k=1e-3, EI_body=EI, EI_tail=EI,
        body_length=0.8 * L, tail_length=0.2 * L, EA_body=EA, EA_tail=EA, K_Q=K_Q,
    )  # fmt: skip
    own = model.robot.with_parts(lambda p: replace(p, GJ=GJ, EI_n=EI_N, polar_inertia=2e-5))
    near, far = jnp.transpose(jnp.asarray(angles))
    space = SpaceSettings(near, 0.0, far, jnp.asarray(distances))
    drive = Drive(tuple(pressures))
    return arrays(replace(model, robot=own, drive=drive, actuators=tuple(tendons), space=space))


def tension_at(y, stage):
    """Tensions [N] of the tendons."""
    mid, _ = means_and_slopes(y, stage.structure.ds)
    curvature = turning_in_cells(vectors(y)[3], stage).curvature
    return tensions_in_space(mid.T.tau, curvature, stage)


@jax.jit
def simulated(model, h, attitude):
    def save(x):
        strains = jnp.stack([*x.section().curvature, x.section().strain])
        return x.y, x.memory.strain, strains, tension_at(x.y, x.stage), x.stage

    begin = at_rest_in_space(model, NUM, 0.0, attitude)
    return spatial_rollout(model, TimeGrid(h, STEPS), save, NUM, begin=begin)


def swinging(wave=SineWave):
    pair = [
        LengthTendon(0.02, 0.3, (e, 0.4 * e), wave(3.0, 2e-3, phase), 3e4, angle=(0.0, 0.0))
        for e, phase in ((0.012, 0.0), (-0.012, 0.5))
    ]
    return *pair, TensionTendon(0.1, 0.2, (0.01, 0.01), wave(2.0, 5.0), angle=(0.0, 0.0))


@pytest.mark.slow
def test_tendons_in_a_rolled_plane_are_the_planar_ones():
    """A slackening pair, a third tendon and chambers with a distance: 1e-8 in two planes."""
    waves = SineWave(2.0, 30e3), SineWave(2.0, 30e3, 0.2)
    model = robot(swinging(), waves, C=(2.0, 1.0))
    times = TimeGrid(0.01, STEPS)
    flat = replace(model, space=None)
    planar = jax.jit(lambda m: rollout(m, times, lambda x: (x.y, x.memory.strain), NUM))(flat)
    for angle in (0.0, 1.0):
        found = simulated(model, 0.01, about_tau(jnp.asarray(angle)))
        assert planar.ok and found.ok
        (y, strain), (z, compressed, _, tension, _) = planar.saved, found.saved
        assert np.min(np.abs(tension)) < 1e-20 and np.max(tension[:, :2]) > 1.0
        for mine, theirs in zip((0, 1, 5, 6, 7), (0, 1, 2, 3, 4), strict=True):
            size = np.abs(y[:, theirs]).max()
            np.testing.assert_allclose(z[:, mine], y[:, theirs], rtol=0, atol=1e-8 * size)
        np.testing.assert_allclose(compressed, strain, rtol=0, atol=1e-8 * np.abs(strain).max())
        for out_of_plane in (2, 3, 4, 8):
            assert np.abs(z[:, out_of_plane]).max() < 1e-12


def rod_line(offset, angle, rate, share, tension):
    """The tendon of `slider statics` for a line in the robot's cells; `rate` is d(angle)/ds.

    The rod begins at the head and has the axes -tau, n and -b: angles change their sign, and their
    rates along the rod do not.
    """
    place = np.stack([np.cos(angle), -np.sin(angle)], axis=1)
    ahead = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    parts = offset[:, None] * place, (rate * offset)[:, None] * ahead, share
    return RodTendon(*(jnp.asarray(x[::-1]) for x in parts), jnp.asarray(tension))


def rod_at_rest(lines, EA=None):
    """Strains (Omega_tau, Omega_n, Omega_b, eps) (4, cells) of the static rod, in robot's axes."""
    one, zero = jnp.ones(CELLS), jnp.zeros(3)
    rod = Rod(
        ds=one * L / CELLS,
        stiffness=jnp.stack([GJ * one, EI_N * one, EI * one], axis=1),
        initial_curvature=jnp.zeros((CELLS, 3)),
        clamp=jnp.diag(jnp.array([-1.0, 1.0, -1.0])),
        weight=jnp.zeros(CELLS),
        EA=None if EA is None else EA * one,
    )
    loads = RodLoads(zero, zero, jnp.array([0.0, 0.0, -1.0]), tuple(lines))
    rest = np.array(solve_equilibrium(rod, loads).strains)[::-1].T
    # The curvature per length towards the tail, along -tau, n and -b.
    return np.stack([rest[0], -rest[1], rest[2], np.zeros(CELLS) if EA is None else rest[3]])


def strains_agree(found, rest):
    """The strains agree to 1e-7 of the largest bending and of the largest strain."""
    print(np.abs(rest).max(axis=1), np.abs(found - rest).max(axis=1))
    size = np.abs(rest[1:3]).max()
    np.testing.assert_allclose(found[:3], rest[:3], rtol=0, atol=1e-7 * size)
    np.testing.assert_allclose(found[3], rest[3], rtol=0, atol=1e-15 + 1e-7 * np.abs(rest[3]).max())


OFF = SineWave(2.0, 0.0), SineWave(2.0, 0.0)
SPANS, ANGLES = ((0.02, 0.3), (0.0, L), (0.1, 0.2613)), ((0.4, 2.5), (-1.0, -3.0), (0.7, 0.7))


def twisting(pulls=(15e-3, 12e-3, 3.0), angles=ANGLES, offsets=(0.012, -0.01, 0.015), k=300.0):
    """Two helical tendons that are driven by length, and one along the axis with a tension."""
    stiffness = (k,), (k,), ()
    kinds = LengthTendon, LengthTendon, TensionTendon
    return [
        kind(*span, (r, r), ramp(pull), *stiff, angle=angle)
        for kind, span, r, pull, stiff, angle in zip(
            kinds, SPANS, offsets, pulls, stiffness, angles, strict=True
        )
    ]


@pytest.mark.slow
def test_helical_tendons_at_rest_give_the_strains_of_the_static_rod():
    """Bending, twist and compression: 1e-7 of the largest bending and compression."""
    found = simulated(robot(twisting(), OFF), SLOW, about_tau(jnp.asarray(0.3)))
    assert found.ok
    strains, tension, stage = jax.tree.map(lambda x: np.array(x[-1]), found.saved[2:])
    assert tension.min() > 1.0 and np.abs(strains[0]).max() > 0.05
    places, share = stage.tendons.places, stage.tendons.share
    lines = zip(places.offset, places.angle, places.rate, share, tension, strict=True)
    strains_agree(strains, rod_at_rest([rod_line(*x) for x in lines], EA))


@pytest.mark.slow
def test_helical_chambers_at_rest_give_the_strains_of_the_static_rod():
    """A left and a right chamber twist and bend the body, to 1e-7 of the largest bending."""
    p, d = (250e3, -150e3), (0.02, 0.03)
    angles = ((0.4, 2.0), (-0.5, 1.5))
    model = robot(twisting((-1.0, -1.0, 0.0)), [ramp(x) for x in p], angles, d)
    found = simulated(model, SLOW, about_tau(jnp.asarray(0.0)))
    assert found.ok
    strains, _, stage = jax.tree.map(lambda x: np.array(x[-1]), found.saved[2:])
    assert np.abs(strains[0]).max() > 0.05
    windows = make_mesh(model.robot, NUM).windows
    places = stage.chambers.places
    lines = [
        rod_line(-math.copysign(r, x) + 0.0 * angle, angle, rate, np.array(w), -abs(x) * K_Q / r)
        for r, x, angle, rate, w in zip(d, p, places.angle, places.rate, windows, strict=True)
    ]
    strains_agree(strains, rod_at_rest(lines))


def bent_stage():
    """An arbitrary bent, twisted and moving state, in which one tendon is slack."""
    model = robot(twisting((0.05, -0.05, 3.0), k=3e4), OFF, ((0.4, 2.0), (-0.5, 1.5)), (0.02, 0.03))
    mesh = spatial_mesh(model.body, NUM)
    s, zero = mesh.grid.s, jnp.zeros(CELLS)
    none, still = Vec(zero, zero, zero), Vec(*jnp.zeros((3, CELLS + 1)))
    sizes = jnp.repeat(jnp.array([2.0, 0.1, 0.3, 0.2]), 3)[:, None]
    y = sizes * jnp.stack([jnp.sin((3.0 + i) * s + i) for i in range(12)])
    places = lines_of_chambers(model.space, model.body.chambers, mesh.structure)
    stage = SpatialStage(
        mesh.structure, model.effects, model.support.during(0.0, 1.0),
        SpatialReference(none, none, zero + 1e-4, zero, jnp.asarray(1e-2)),
        turned(still), still, none, jnp.zeros((2, 3)), jnp.asarray(25.0),
        tendon_lines(model.actuators, mesh.structure),
        chamber_lines(places, jnp.array([2e5, -1e5]), mesh.chambers),
    )  # fmt: skip
    return y, stage


@pytest.mark.slow
def test_the_jacobian_with_tendons_and_chambers_is_that_of_the_residual():
    """1e-9 of the largest value of each row, in four directions."""
    y, stage = bent_stage()
    directions = jnp.asarray(np.random.default_rng(3).normal(size=(4, *y.shape)))

    @jax.jit
    def products(y, stage):
        operator = spatial_jacobian(y, stage)
        local = replace(operator, update=None)

        def product(v):
            exact = jax.jvp(lambda y: spatial_residual(y, stage), (y,), (v,))[1]
            return exact, operator.mv(v), local.mv(v)

        return tension_at(y, stage), jax.vmap(product)(directions)

    tension, (exact, found, local) = products(y, stage)
    assert float(tension[1]) == 0.0 < float(tension[0])
    for a, b in zip(exact, found, strict=True):
        size = jnp.abs(a).max(axis=(0, -1) if a.ndim == 3 else 0, keepdims=True)
        assert bool(jnp.all(jnp.abs(a - b) <= 1e-9 * size))
    assert float(jnp.abs(exact[0] - local[0]).max() / jnp.abs(exact[0]).max()) > 1e-4


@pytest.mark.slow
def test_derivatives_by_angles_offset_stiffness_and_distance():
    """Forward and reverse: 1e-12 of the largest; 1e-6 against differences."""
    values = jnp.array([0.4, 2.5, 0.012, 3e4, 0.02, 1.4])

    def tip(x):
        pulls = (SineWave(3.0, 4e-3), SineWave(3.0, 3e-3, 0.3), SineWave(2.0, 5.0))
        tendons = [replace(a, **{k: w}) for a, k, w in zip(
            twisting((0.0, 0.0, 0.0), ((x[0], x[1]), *ANGLES[1:]), (x[2], -0.01, 0.015)),
            ("pull", "pull", "wave"), pulls, strict=True,
        )]  # fmt: skip
        tendons[0] = replace(tendons[0], stiffness=x[3], pushes=True)
        waves = SineWave(2.0, 100e3, 0.1), SineWave(2.0, 100e3, 0.4)
        angles, d = jnp.array([[0.1, 0.5], [-0.2, 0.0]]).at[0, 1].set(x[5]), jnp.array([0.0, 0.03])
        model = robot(tendons, waves, angles, d.at[0].set(x[4]), (2.0, 1.0))
        save = lambda x: x.positions()[:, 0]  # noqa: E731
        # Stiff tendons amplify rounding errors, so that stages do not converge to 1e-13.
        numerics = replace(NUM, tolerance=1e-11)
        found = spatial_rollout(model, TimeGrid(5e-3, 12), save, numerics)
        return jnp.sum(found.saved[-1]), found.ok

    reverse, tangents = (
        jax.jit(jax.value_and_grad(tip, has_aux=True)),
        jax.jacfwd(tip, has_aux=True),
    )
    (_, ok), backward = reverse(values)
    forward, backward = np.array(jax.jit(tangents)(values)[0]), np.array(backward)
    print(forward * values, np.abs(backward - forward).max() / np.abs(forward).max())
    assert bool(ok)
    assert np.all(np.abs(forward) > 0.0)
    np.testing.assert_allclose(backward, forward, rtol=1e-11, atol=1e-12 * np.abs(forward).max())
    for i in range(len(values)):
        step = jnp.zeros(len(values)).at[i].set(3e-3 * values[i])
        at = [float(reverse(values + k * step)[0][0]) for k in (-2, -1, 1, 2)]
        difference = (8.0 * (at[2] - at[1]) - (at[3] - at[0])) / (12.0 * step[i])
        print(i, float(difference / forward[i]) - 1.0)
        assert difference == pytest.approx(float(forward[i]), rel=1e-6)
