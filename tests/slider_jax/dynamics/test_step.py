"""The pieces of a step: its predictor, its refusals, and what a failed member costs."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.dynamics.newton import BeamNewton
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import at_rest
from slider_jax.dynamics.time_schemes import BACKWARD_EULER, KNOWN, SDIRK2, extrapolation
from tests.support.helpers import SMALL, observe, swimmer

SOLUTIONS = 6
"""Number of steps with solutions at every stage."""


@pytest.mark.parametrize("scheme", [BACKWARD_EULER, SDIRK2], ids=lambda s: s.name)
@pytest.mark.parametrize("error", [0.0, 0.3])
def test_the_predictor_is_exact_for_a_parabola_with_an_error_that_repeats(scheme, error):
    """Each solution is predicted from those before it; the error belongs to the first stage."""
    nodes = np.arange(SOLUTIONS)[:, None] + np.array(scheme.nodes)
    values = 1.0 - 2.0 * nodes + 3.0 * nodes**2
    values[:, 0] += error
    for stage, weights in enumerate(extrapolation(scheme)):
        target = values.size - scheme.stages + stage
        known = values.ravel()[target - KNOWN : target]
        np.testing.assert_allclose(weights @ known, values.ravel()[target], rtol=1e-12)


def test_float32_raises_an_error_that_names_enable_float64():
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match=r"float64.*enable_float64"):
            jax.eval_shape(lambda: rollout(swimmer(), TimeGrid(1e-3, 2), observe, SMALL))
    finally:
        jax.config.update("jax_enable_x64", True)


@pytest.mark.parametrize("wrong", [{"corrections": 1}, {"atol": 1e-6}])
def test_a_root_finder_that_cannot_estimate_its_error_is_refused(wrong):
    with pytest.raises(ValueError, match="allowed"):
        BeamNewton(rtol=1e-8, **wrong)


@pytest.mark.slow
def test_a_failed_member_costs_no_further_time_and_keeps_its_state():
    model, steps = swimmer(), 20
    begin = dataclasses.replace(at_rest(model, SMALL), ok=jnp.asarray(False))
    run = jax.jit(lambda begin: rollout(model, TimeGrid(1e-3, steps), observe, SMALL, begin=begin))
    out = run(begin)
    assert int(out.final.factorisations) == 0
    for kept, given in zip(
        jax.tree.leaves(out.final.memory), jax.tree.leaves(begin.memory), strict=True
    ):
        np.testing.assert_array_equal(kept, given)
    count = int(run(at_rest(model, SMALL)).final.factorisations)
    assert steps <= count < 1.1 * steps
