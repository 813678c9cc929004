"""Tendons and measured moments: static shapes in closed form, Jacobian, dynamics, derivatives."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation import LengthTendon, MeasuredMoment, SineWave, TensionTendon
from slider_jax.actuation.waveform import Recorded
from slider_jax.beam.parameters import Numerics, grid_of
from slider_jax.dynamics.block_solver import BeamSolver
from slider_jax.dynamics.residual import jacobian, residual, tensions_of
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.statics import Loads, release
from slider_jax.effects import NormalDrag, ReactiveForce
from tests.support.helpers import (
    SMALL,
    arrays,
    flat_residual,
    march,
    order,
    stage_of,
    static_state,
    uniform,
)

L, EI, EA = 0.368, 0.038, 2.0e3
NONE = Loads(jnp.zeros(2), jnp.zeros(2))
FINE = Numerics(tail_cells=10, body_cells=40)
SPAN = (0.0, L)
WATER = (NormalDrag(2.0), ReactiveForce(1.0))


def constant(value):
    return Recorded(jnp.array([0.0, 1.0]), jnp.full(2, value))


def rod(*actuators, effects=(), **robot):
    model = uniform(L, EI, effects, EA_body=EA, EA_tail=EA, **robot)
    return arrays(replace(model, actuators=actuators))


def at_rest(model, numerics=FINE):
    """The static state, its curvature (cells,) and the nodes' distances from the tail."""
    found = static_state(model, NONE, numerics)
    grid = grid_of(model.robot, numerics)
    assert bool(found.ok)
    return found, np.asarray(grid.slope(found.y[5])), np.asarray(grid.s)


def test_tendon_bends_an_arc_and_compresses_the_axis():
    """Curvature P e/EI and strain -P/EA; the tip is on the arc to 0.1 % of its deflection."""
    P, e = 8.0, 0.01
    found, kappa, _ = at_rest(rod(TensionTendon(*SPAN, e, constant(P))))
    expected = P * e / EI
    assert kappa == pytest.approx(expected, rel=1e-8)
    assert np.asarray(found.strain) == pytest.approx(-P / EA, rel=1e-8)
    turn, short = expected * L, 1.0 - P / EA
    tip = short / expected * np.array([-np.sin(turn), 1.0 - np.cos(turn)])
    off = np.abs(np.asarray(found.shape[:, 0]) - tip).max() / tip[1]
    print(f"curvature {expected:.3f} 1/m, tip off {100 * off:.4f} % of the deflection")
    assert off < 1e-3


@pytest.mark.parametrize("span", [(0.05, 0.25), (0.0613, 0.2907)])
def test_tendon_acts_in_its_span_only(span):
    """The angle of the tip is P e (far - near)/EI, also if the ends are inside cells."""
    P, e = 8.0, -0.01
    found, kappa, s = at_rest(rod(TensionTendon(*span, e, constant(P))))
    assert float(found.y[5, 0]) == pytest.approx(-P * e * (span[1] - span[0]) / EI, rel=1e-8)
    middle = L - 0.5 * (s[1:] + s[:-1])
    outside = (middle < span[0] - 0.01) | (middle > span[1] + 0.01)
    assert np.abs(kappa[outside]).max() < 1e-9 * np.abs(kappa).max()


@pytest.mark.slow
def test_offset_that_changes_along_the_tendon():
    """0.1 % of the tip: phi = -int P e(d)/EI dd with e linear, against a fine quadrature."""
    P, near, far, ends = 8.0, 0.04, 0.3, (0.012, -0.004)
    found, _, _ = at_rest(rod(TensionTendon(near, far, ends, constant(P))))
    points = 20_000
    d = (np.arange(points) + 0.5) * L / points
    e = np.where((d > near) & (d < far), np.interp(d, (near, far), ends), 0.0)
    phi = -np.cumsum(P * e / EI) * L / points
    y = -np.sum((1.0 - P / EA * (e != 0.0)) * np.sin(phi)) * L / points
    print(f"tip {1e3 * float(found.shape[1, 0]):.4f} mm, exact {1e3 * y:.4f} mm")
    assert float(found.shape[1, 0]) == pytest.approx(y, rel=1e-3)


@pytest.mark.slow
def test_length_driven_tendon_shares_the_length_with_the_body():
    """P (1 + k L (1/EA + e^2/EI)) = k pull, to 0.1 %, for two tendons on one side and one apart."""
    k, e, pull = 2e4, 0.01, 4e-3
    tendon = LengthTendon(*SPAN, e, constant(pull), k)
    for count in (1, 2):
        found, kappa, _ = at_rest(rod(*[tendon] * count))
        P = k * pull / (1.0 + count * k * L * (1.0 / EA + e**2 / EI))
        assert kappa == pytest.approx(count * P * e / EI, rel=1e-3)
        assert np.asarray(found.strain) == pytest.approx(-count * P / EA, rel=1e-3)
    stretched, kappa, _ = at_rest(rod(tendon, LengthTendon(*SPAN, -e, constant(0.0), k)))
    # The opposite tendon is stretched by the curvature and resists it.
    A = k * L * np.array([[1 / EA + e**2 / EI, 1 / EA - e**2 / EI]])
    A = np.concatenate([A, A[:, ::-1]]) + np.eye(2)
    P = np.linalg.solve(A, [k * pull, 0.0])
    P = np.array([k * pull / A[0, 0], 0.0]) if P[1] < 0 else P
    print(f"tensions {P} N")
    assert kappa == pytest.approx((P[0] - P[1]) * e / EI, rel=1e-3)


@pytest.mark.slow
def test_a_slack_tendon_carries_nothing_and_a_rod_pushes():
    tendon = LengthTendon(*SPAN, 0.01, constant(-1e-3), 2e4)
    _, kappa, _ = at_rest(rod(tendon))
    assert np.abs(kappa).max() < 1e-12
    _, kappa, _ = at_rest(rod(replace(tendon, pushes=True)))
    assert kappa.max() < -0.01


def test_negative_tension_counts_as_zero():
    _, kappa, _ = at_rest(rod(TensionTendon(*SPAN, 0.01, constant(-5.0))))
    assert np.abs(kappa).max() < 1e-12


@pytest.mark.slow
def test_measured_moment_is_bilinear_in_command_and_curvature():
    """M_act = a c - b kappa gives the static curvature a c/(EI + b), to 0.1 %."""
    a, b, command = 0.02, 0.01, 3.3
    commands, curvatures = jnp.array([0.0, 1.0, 4.0, 5.0]), jnp.linspace(-5.0, 5.0, 9)
    table = a * commands[:, None] - b * curvatures
    actuator = MeasuredMoment(*SPAN, constant(command), commands, curvatures, table)
    _, kappa, _ = at_rest(rod(actuator))
    assert kappa == pytest.approx(a * command / (EI + b), rel=1e-8)


PAIR = (
    LengthTendon(0.02, 0.3, (0.012, 0.004), SineWave(3.0, 2e-3), 3e4),
    LengthTendon(0.02, 0.3, (-0.012, -0.004), SineWave(3.0, 2e-3, 0.5), 3e4),
    TensionTendon(0.1, 0.2, 0.01, SineWave(2.0, 5.0)),
)
"""An antagonistic pair, each slack in half of the period, and a tendon with given tension."""


def driven(pair=PAIR):
    return rod(*pair, effects=WATER, damping_time=2e-3)


def bent_stage():
    """An arbitrary bent, loaded and moving state, in which one tendon is slack."""
    model = driven()
    s = grid_of(model.robot, SMALL).s
    y = jnp.stack([jnp.sin((3.0 + i) * s + i) for i in range(6)])
    y = y * jnp.array([2.0, 1.0, 0.1, 0.1, 0.2, 0.02])[:, None]
    stage = stage_of(model, SMALL, 0.9 * y, 1e-3, t=0.07)
    return y, replace(stage, actuators=model.actuators)


@pytest.mark.slow
def test_jacobian_and_solver_match_a_dense_matrix():
    y, stage = bent_stage()
    assert float(tensions_of(y, stage).min()) == 0.0 < float(tensions_of(y, stage).max())
    dense = jax.jacfwd(lambda v: flat_residual(v.reshape(y.shape), stage))(y.ravel())
    operator = jacobian(y, stage)
    scale = jnp.abs(dense).max(axis=1, keepdims=True)
    assert float(jnp.abs((operator.as_matrix() - dense) / scale).max()) < 1e-9
    local = replace(operator, update=None).as_matrix()
    assert float(jnp.abs((local - dense) / scale).max()) > 1e-4
    value = residual(y + 1e-3, stage)
    solver = BeamSolver()
    state = solver.init(operator, {})
    found, _, _ = solver.compute(state, value, {})
    exact = jnp.linalg.solve(dense, jnp.concatenate([x.ravel() for x in value]))
    size = jnp.abs(exact.reshape(y.shape)).max(axis=1, keepdims=True)
    assert float(jnp.abs((found - exact.reshape(y.shape)) / size).max()) < 1e-7


@pytest.mark.slow
def test_motion_converges_at_second_order():
    """Taut or pushing tendons; order above 1.8 of tensions, tip angle and recoil."""
    runs = [runs_of([replace(x, pushes=True) for x in PAIR[:2]], n) for n in (160, 320, 640)]
    changes = [np.abs(a - b).max(axis=0) for a, b in zip(runs, runs[1:], strict=False)]
    slopes = [order([2.0, 1.0], x) for x in np.transpose(changes)]
    print("orders of tensions, tip angle and recoil", np.round(slopes, 2))
    assert min(slopes) > 1.8


@pytest.mark.slow
def test_motion_converges_while_tendons_slacken():
    """No stage fails, and the change from 320 to 640 steps is below 1 % of the largest angle."""
    runs = [runs_of(PAIR[:2], n) for n in (320, 640)]
    slack = runs[-1][:, :2] == 0.0
    change = np.abs(runs[0] - runs[1]).max(axis=0) / np.abs(runs[1]).max(axis=0)
    print(f"slack: {slack.mean(axis=0)} of the time; changes {change}")
    assert np.all(runs[-1][:, :2] >= 0.0) and np.all(slack.mean(axis=0) > 0.2)
    assert change[2] < 0.01


def runs_of(pair, steps):
    """80 samples of the tensions [N], the tip's angle [rad] and the recoil [N] over 0.32 s."""

    def save(x):
        return jnp.append(tensions_of(x.y, x.stage), jnp.stack([x.y[5, 0], x.y[1, -1]]))

    return march(driven(tuple(pair)), 0.32 / steps, steps, save)[1][steps // 80 - 1 :: steps // 80]


@pytest.mark.slow
def test_derivatives_agree_with_finite_differences():
    def tip(stiffness):
        tendon = replace(PAIR[0], stiffness=stiffness)
        model = driven((tendon, *PAIR[1:]))
        out = rollout(model, TimeGrid(2e-3, 30), lambda x: x.y[5, 0], SMALL)
        return out.saved[-1]

    k = jnp.asarray(3e4)
    value = eqx.filter_jit(tip)
    exact = (value(1.001 * k) - value(0.999 * k)) / (0.002 * k)
    _, forward = eqx.filter_jit(lambda k: jax.jvp(tip, (k,), (jnp.ones_like(k),)))(k)
    reverse = eqx.filter_jit(jax.grad(tip))(k)
    print(f"d(tip angle)/d(stiffness) {float(exact):.6e}, {float(forward):.6e}")
    assert float(forward) == pytest.approx(float(exact), rel=1e-4)
    assert float(reverse) == pytest.approx(float(forward), rel=1e-8)


@pytest.mark.slow
def test_a_held_tendon_stays_in_its_static_shape():
    model = rod(LengthTendon(0.02, 0.3, 0.01, constant(2e-3), 3e4), damping_time=2e-3)
    static, kappa, _ = at_rest(model, SMALL)
    begin = release(model, static, SMALL)
    out = rollout(model, TimeGrid(1e-3, 20), lambda x: x.section().kappa, SMALL, begin=begin)
    assert bool(out.ok)
    assert np.asarray(out.saved) == pytest.approx(np.tile(kappa, (20, 1)), abs=1e-6)
