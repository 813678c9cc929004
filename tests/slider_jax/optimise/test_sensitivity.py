"""Gradient and Hessian of the steady speed at a design, against differences of the speed itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.optimise.design_space import speed_of
from slider_jax.optimise.fastest_swimmer import Task, sensitivity
from slider_jax.swimming.paper_optimum import PAPER_GAIT, optimum

STEP = 0.02


@pytest.fixture(scope="module")
def task():
    experiment = optimum().with_values({"numerics.nodes": 17})
    return Task.of(experiment, {"tail_length": (0.04, 0.1), "EI_tail": (0.006, 0.03)}, 48)


@pytest.fixture(scope="module")
def speed(task):
    converged = task.search._replace(settling=10, corrections=12)
    return jax.jit(speed_of(task.experiment, task.box, converged))


@pytest.mark.slow
@pytest.mark.parametrize("place", ["inside", "on a face"])
def test_gradient_and_hessian_are_those_of_the_speed(task, speed, place):
    unit = np.clip(task.box.unit(PAPER_GAIT), 0.2, 0.8)
    if place == "on a face":
        unit[1], unit[5] = 1.0, 0.0
    found = sensitivity(task, unit, STEP)
    np.testing.assert_array_equal(found.hessian, found.hessian.T)
    # The Hessian is taken where both its points are in the box.
    middle = np.clip(unit, STEP, 1.0 - STEP)

    def at(x):
        return float(speed(jnp.asarray(x)))

    for i, e in enumerate(np.eye(6)):
        h = 2e-3
        slope = (at(unit + h * e) - at(unit - h * e)) / (2.0 * h)
        bend = (at(middle + 2 * STEP * e) - 2.0 * at(middle) + at(middle - 2 * STEP * e)) / (
            4.0 * STEP**2
        )
        print(f"{i}: {found.gradient[i]:.5f} {slope:.5f}   {found.hessian[i, i]:.4f} {bend:.4f}")
        assert found.gradient[i] == pytest.approx(slope, rel=0.01, abs=1e-4)
        assert found.hessian[i, i] == pytest.approx(bend, rel=0.05, abs=0.01)
