"""Tests of a free body: its momentum gain equals the impulse of the water."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation import SineWave
from slider_jax.beam.parameters import Numerics
from slider_jax.beam.state import straight_state, to_plane
from slider_jax.dynamics.pressures import start_chambers
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import initial_carry
from slider_jax.effects import total_force
from slider_jax.supports import Free
from tests.support.helpers import nodes_of, swimmer

FINE = Numerics(tail_cells=10, body_cells=40)
STEPS, H = 400, 2.5e-4


def budget(x):
    """Returns momentum [N s], force of the water [N], and the integrals of their magnitudes."""
    cell, grid = x.section(), x.mesh.grid
    P = cell.linear_density * jnp.stack(to_plane(cell.V_tau, cell.V_n, cell.phi))
    stretch = 1.0 + cell.strain
    F = stretch * jnp.stack(to_plane(*total_force(x.stage.effects, cell), cell.phi))
    length = lambda v: grid.integral(jnp.sqrt(jnp.sum(v**2, axis=0) + 1e-30))  # noqa: E731
    return grid.integral(P), grid.integral(F), length(P), length(F), x.y[5]


@eqx.filter_jit
def swim(model, h, y, memory):
    begin = initial_carry(y, memory, start_chambers(model))
    return rollout(model, TimeGrid(h, STEPS), budget, FINE, begin=begin)


def free_swimmer(**options):
    return swimmer(frequency=2.0, wave=SineWave, support=Free(), **options)


def spinning(model):
    """Returns a state that rotates at 3 rad/s about mid-body, which moves at (0.3, 0.1) m/s."""
    s = nodes_of(model, FINE)
    return straight_state(s, 0.3, 0.1 + 1.5 * s[-1], omega=3.0)


@pytest.mark.slow
def test_momentum_gained_is_the_impulse_of_the_water():
    """The impulse is a trapezoidal sum; the error is relative to the exchanged momentum."""
    model = free_swimmer()
    y, memory = straight_state(nodes_of(model, FINE))
    out = swim(model, jnp.asarray(H), y, memory)
    assert bool(out.ok)
    P, F, _, exchanged, phi = map(np.asarray, out.saved)
    F = np.concatenate([np.zeros((1, 2)), F])
    impulse = H * np.cumsum(0.5 * (F[1:] + F[:-1]), axis=0)
    total = H * exchanged.sum()
    off = np.abs(P - impulse).max() / total
    bend = np.ptp(phi[-1])
    print(
        f"bent by {bend:.2f} rad, impulse {impulse[-1]}, exchanged {total:.2e} N s: error {off:.1e}"
    )
    assert bend > 0.1 and np.abs(impulse[-1]).max() > 1e-3 * total
    assert off < 1e-6


def dry():
    return free_swimmer(C_d=0.0, m_a=0.0)


def test_a_body_without_forces_drifts_at_constant_velocity():
    model = eqx.tree_at(lambda m: m.robot.K_Q, dry(), jnp.zeros(()))
    out = swim(model, jnp.asarray(H), *straight_state(nodes_of(model, FINE), 0.5, -0.2))
    P = np.asarray(out.saved[0])
    mass = float(model.robot.mass)
    assert bool(out.ok)
    np.testing.assert_allclose(P / mass, [[0.5, -0.2]] * STEPS, atol=1e-9)


def test_a_spinning_body_keeps_its_velocity():
    model = eqx.tree_at(lambda m: m.robot.K_Q, dry(), jnp.zeros(()))
    out = swim(model, jnp.asarray(H), *spinning(model))
    P, _, size, _, phi = map(np.asarray, out.saved)
    off = np.abs(P - P[0]).max() / size.max()
    print(f"turned {phi[-1, 0]:.2f} rad; velocity changed by {off:.1e} of the speeds in it")
    assert bool(out.ok) and phi[-1, 0] > 0.25
    assert off < 1e-6


def test_internal_moments_do_not_move_the_centre_of_mass():
    """The chambers bend a spinning body in vacuum; its momentum is constant."""
    model = dry()
    out = swim(model, jnp.asarray(H), *spinning(model))
    P, _, size, _, phi = map(np.asarray, out.saved)
    off = np.abs(P - P[0]).max() / size.max()
    print(f"bent by {np.ptp(phi[-1]):.2f} rad; velocity changed by {off:.1e} of the speeds in it")
    assert bool(out.ok) and np.ptp(phi[-1]) > 0.1
    assert off < 1e-6
