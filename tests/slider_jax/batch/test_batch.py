"""A batch equals separate runs, and a diverging robot does not affect the others."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.dynamics.rollout import TimeGrid, rollout
from tests.support.helpers import SMALL, observe, swimmer

MEMBERS, BAD, STEPS, H = 112, 57, 24, 2e-3
BASE = swimmer(frequency=4.8)


def outcome(parameters):
    """Returns the loss, its parts and whether the run converged, for (C_d, EI_body, K_Q factor)."""
    C_d, EI, K = parameters
    model = eqx.tree_at(
        lambda m: (m.effects[0].C_d, m.robot.body.EI, m.robot.K_Q),
        BASE,
        (C_d, EI, K * BASE.robot.K_Q),
    )
    out = rollout(model, TimeGrid(jnp.asarray(H), STEPS), observe, SMALL)
    return jnp.sum(out.saved[-1] ** 2), (out.saved, out.ok, out.final.failed_at)


single = jax.jit(outcome)
batched = jax.jit(jax.vmap(outcome))
graded = jax.jit(jax.vmap(jax.value_and_grad(outcome, has_aux=True)))
BAD_ROBOTS = {"not a number": (3.0, np.nan, 1.0), "absurd moment": (3.0, 0.038, 1e9)}


def population():
    rng = np.random.default_rng(0)
    low, high = np.array([2.0, 0.03, 0.5]), np.array([4.0, 0.05, 1.5])
    return jnp.asarray(rng.uniform(low, high, (MEMBERS, 3)))


@pytest.fixture(scope="module")
def healthy():
    loss, (saved, ok, _) = batched(population())
    assert bool(jnp.all(ok))
    return np.asarray(loss), np.asarray(saved)


@pytest.mark.slow
def test_vmap_equals_a_loop_over_robots(healthy):
    loss, saved = healthy
    worst = 0.0
    for i in range(0, MEMBERS, 10):
        alone, (series, _, _) = single(population()[i])
        worst = max(worst, np.abs(saved[i] - series).max() / np.abs(series).max())
        assert float(alone) == pytest.approx(loss[i], rel=1e-10)
    print(f"vmap against loop: {worst:.1e} of the largest value")
    assert worst < 1e-10


@pytest.mark.parametrize("bad", BAD_ROBOTS)
def test_a_diverging_robot_does_not_affect_the_other_111(healthy, bad):
    loss, saved = healthy
    new_loss, (new_saved, ok, failed_at) = batched(population().at[BAD].set(BAD_ROBOTS[bad]))
    others = np.arange(MEMBERS) != BAD
    assert not bool(ok[BAD]) and bool(jnp.all(ok[others]))
    assert 0.0 < float(failed_at[BAD]) <= STEPS * H
    assert np.all(np.isinf(failed_at[others]))
    change = np.abs(np.asarray(new_saved) - saved)[others].max() / np.abs(saved).max()
    assert change < 1e-10
    np.testing.assert_allclose(np.asarray(new_loss)[others], loss[others], rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("bad", BAD_ROBOTS)
def test_a_diverging_robot_does_not_affect_the_gradients_of_the_others(bad):
    slope = np.asarray(graded(population())[1])
    new_slope = np.asarray(graded(population().at[BAD].set(BAD_ROBOTS[bad]))[1])
    others = np.arange(MEMBERS) != BAD
    assert np.isfinite(slope).all()
    assert np.abs(new_slope - slope)[others].max() < 1e-10 * np.abs(slope).max()
