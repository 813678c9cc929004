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
        lambda m: (m.effects[0].C_d, m.robot.EI_body, m.robot.K_Q),
        BASE,
        (C_d, EI, K * BASE.robot.K_Q),
    )
    out = rollout(model, TimeGrid(jnp.asarray(H), STEPS), observe, SMALL)
    return jnp.sum(out.saved[-1] ** 2), (out.saved, out.ok, out.final.failed_at)


single = jax.jit(outcome)
batched = jax.jit(jax.vmap(jax.value_and_grad(outcome, has_aux=True)))


def population():
    rng = np.random.default_rng(0)
    low, high = np.array([2.0, 0.03, 0.5]), np.array([4.0, 0.05, 1.5])
    return jnp.asarray(rng.uniform(low, high, (MEMBERS, 3)))


@pytest.fixture(scope="module")
def healthy():
    (loss, (saved, ok, _)), slope = batched(population())
    assert bool(jnp.all(ok)) and bool(jnp.all(jnp.isfinite(slope)))
    return np.asarray(loss), np.asarray(saved), np.asarray(slope)


def test_vmap_equals_a_loop_over_robots(healthy):
    loss, saved, _ = healthy
    worst = 0.0
    for i in range(0, MEMBERS, 10):
        alone, (series, _, _) = single(population()[i])
        worst = max(worst, np.abs(saved[i] - series).max() / np.abs(series).max())
        assert float(alone) == pytest.approx(loss[i], rel=1e-10)
    print(f"vmap against loop: {worst:.1e} of the largest value")
    assert worst < 1e-10


@pytest.mark.parametrize(
    "bad", [(3.0, np.nan, 1.0), (3.0, 0.038, 1e9)], ids=["not a number", "absurd moment"]
)
def test_a_diverging_robot_does_not_affect_the_other_111(healthy, bad):
    loss, saved, slope = healthy
    (new_loss, (new_saved, ok, failed_at)), new_slope = batched(population().at[BAD].set(bad))
    others = np.arange(MEMBERS) != BAD
    assert not bool(ok[BAD]) and bool(jnp.all(ok[others]))
    assert 0.0 < float(failed_at[BAD]) <= STEPS * H
    assert np.all(np.isinf(failed_at[others]))
    change = np.abs(np.asarray(new_saved) - saved)[others].max() / np.abs(saved).max()
    slopes = np.abs(np.asarray(new_slope) - slope)[others].max() / np.abs(slope).max()
    print(f"the others' series changed by {change:.1e}, their gradients by {slopes:.1e}")
    assert change < 1e-10 and slopes < 1e-10
    np.testing.assert_allclose(np.asarray(new_loss)[others], loss[others], rtol=1e-10)
