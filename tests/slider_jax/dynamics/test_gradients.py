"""Derivatives of the mean thrust: forward, reverse and central differences agree."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics
from slider_jax.dynamics.rollout import TimeGrid, block_size, rollout
from slider_jax.dynamics.step import at_rest
from tests.support.helpers import SMALL, swimmer

NAMES = ("C_d", "m_a", "k", "K_Q", "EI_body", "EI_tail")
PER_STRIDE, STRIDES = 40, 3
FINE = Numerics(tail_cells=10, body_cells=40, tolerance=1e-8)
BASE = swimmer(frequency=4.8, C_d=3.0, m_a=0.8)


def leaves(model):
    drag, reactive = model.effects
    robot = model.robot
    law = model.pressure_law
    return drag.C_d, reactive.m_a, law.k, robot.K_Q, robot.body.EI, robot.tail.EI


def mean_thrust(factors):
    """Mean thrust [N] over the last stride; `factors` multiply the six parameters."""
    values = tuple(f * p for f, p in zip(factors, leaves(BASE), strict=True))
    model = eqx.tree_at(leaves, BASE, values)
    times = TimeGrid.per_stride(model.drive.waves[0].frequency, PER_STRIDE, STRIDES)
    out = rollout(model, times, lambda x: -x.y[0, -1], FINE)
    return jnp.mean(out.saved[-PER_STRIDE:]), out.ok


def test_derivatives_through_a_few_steps_agree_forward_in_reverse_and_by_differences():
    """The coarse twin of the slow test below: two parameters, six steps, a small mesh."""

    def thrust(factors):
        C_d, _, k, _, EI_body, _ = leaves(BASE)
        values = (C_d, leaves(BASE)[1], k * factors[0], leaves(BASE)[3], EI_body * factors[1])
        model = eqx.tree_at(leaves, BASE, (*values, leaves(BASE)[5]))
        out = rollout(model, TimeGrid(5e-3, 6), lambda x: -x.y[0, -1], SMALL)
        return jnp.mean(out.saved)

    along = jax.jit(lambda at, step: jax.jvp(thrust, (at,), (step,)))
    one, h = jnp.ones(2), 1e-5
    value = along(one, one)[0]
    forward = np.array([along(one, e)[1] for e in np.eye(2)])
    reverse = jax.jit(jax.grad(thrust))(one)
    central = np.array(
        [(along(one + h * e, e)[0] - along(one - h * e, e)[0]) / (2.0 * h) for e in np.eye(2)]
    )
    assert np.all(np.abs(central) > 1e-3 * abs(float(value)))
    np.testing.assert_allclose(reverse, forward, rtol=1e-10)
    np.testing.assert_allclose(forward, central, rtol=1e-5)


@pytest.mark.slow
def test_forward_reverse_and_central_differences_agree():
    one = jnp.ones(6)
    value = jax.jit(mean_thrust)
    thrust, ok = value(one)
    assert bool(ok)
    forward, _ = jax.jit(jax.jacfwd(mean_thrust, has_aux=True))(one)
    reverse, _ = jax.jit(jax.grad(mean_thrust, has_aux=True))(one)

    def difference(i, h):
        step = jnp.zeros(6).at[i].set(h)
        return (value(one + step)[0] - value(one - step)[0]) / (2.0 * h)

    # Richardson's extrapolation of two central differences: the drag's kinks leave h^2 terms.
    central = np.array([(4 * difference(i, 1e-4) - difference(i, 2e-4)) / 3 for i in range(6)])
    size = np.maximum(np.abs(central), 1e-3 * np.abs(central).max())
    for name, f, r, c in zip(NAMES, forward, reverse, central, strict=True):
        print(f"{name}: forward {f:.9e}, reverse {r:.9e}, central {c:.9e} N per unit factor")
    print(f"reverse off {np.max(np.abs(reverse - forward) / size):.1e}")
    print(f"central off {np.abs(forward - central) / size}")
    assert np.all(np.abs(central) > 1e-3 * abs(float(thrust)))
    np.testing.assert_allclose(reverse, forward, rtol=1e-8, atol=1e-10)
    assert np.all(np.abs(forward - central) < 1e-5 * size)


def thrust_of(C_d, steps, checkpoint=True):
    model, times = swimmer(C_d=C_d), TimeGrid(1e-3, steps)
    run = rollout(model, times, lambda x: x.y[0, -1], SMALL, checkpoint=checkpoint)
    return jnp.mean(run.saved)


def kept_bytes(steps, checkpoint):
    """Bytes that reverse mode keeps between the forward and the backward pass."""
    kept = jax.eval_shape(
        lambda x: jax.vjp(lambda C_d: thrust_of(C_d, steps, checkpoint), x)[1], 3.0
    )
    return sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(kept))


def test_reverse_mode_stores_little_more_than_the_carry_of_each_block():
    carry = sum(x.nbytes for x in jax.tree.leaves(at_rest(swimmer(), SMALL)))
    bounded, unbounded = kept_bytes(100, True), kept_bytes(100, False)
    print(f"a carry is {carry} bytes; {bounded} kept, {unbounded} without checkpoints")
    assert bounded < 1.5 * 10 * carry
    assert unbounded > 50 * bounded


@pytest.mark.slow
def test_the_backward_pass_keeps_few_values_of_the_steps_of_a_block():
    """400 steps in 20 blocks: 76 carries. Without the inner checkpoints, there are 190."""
    gradient = jax.jit(jax.grad(lambda C_d: thrust_of(C_d, 400)))
    used = gradient.lower(3.0).compile().memory_analysis().temp_size_in_bytes
    carry = sum(x.nbytes for x in jax.tree.leaves(at_rest(swimmer(), SMALL)))
    print(f"{used / carry:.0f} carries")
    assert used < 100 * carry


def test_a_block_has_about_the_square_root_of_the_number_of_steps():
    assert [block_size(n) for n in (1, 6, 7, 36, 360)] == [1, 2, 1, 6, 18]


def test_reverse_mode_computes_each_solution_only_twice():
    """In the forward pass, and once in the backward pass: the derivatives of a step use it."""

    def searches(function):
        return str(jax.make_jaxpr(function)(3.0)).count(" while[")

    once = searches(lambda C_d: thrust_of(C_d, 4))
    assert once > 0
    assert searches(jax.grad(lambda C_d: thrust_of(C_d, 4))) == 2 * once
