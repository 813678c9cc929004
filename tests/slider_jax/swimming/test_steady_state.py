"""The steady speed of a swimmer: found as a root, and by swimming until nothing changes."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibration.free_swimming.published_speeds import OPTIMUM, paper_swimmer
from slider_jax.beam.parameters import Numerics
from slider_jax.dynamics.step import at_rest
from slider_jax.effects.body.rest_curvature import RestCurvature
from slider_jax.effects.pneumatics.valve_delay import ValveDelay
from slider_jax.swimming.gait import Gait
from slider_jax.swimming.performance import next_stride, performance
from slider_jax.swimming.steady_state import (
    SteadySettings,
    find_steady,
    simulate_strides,
    steady_speed,
    with_added_velocity,
)

SEARCH = SteadySettings(steps_per_stride=48, numerics=Numerics(4, 12))
GAITS = {
    "optimum": OPTIMUM.gaits["as the paper gives it"],
    "5 Hz": Gait(5.0, 365e3, 365e3, 0.2, 0.070, 0.0058),
    "slow": Gait(2.5, 200e3, 150e3, 0.1, 0.060, 0.010),
}


def made(gait, area=2e-3):
    return paper_swimmer(gait, "head_drag", area)


search = jax.jit(lambda model, f: find_steady(model, f, SEARCH))
swim = jax.jit(
    lambda model, f: simulate_strides(model, f, at_rest(model, SEARCH.numerics), 120, SEARCH)[1]
)


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("optimum", "5 Hz")]


@pytest.mark.parametrize("name", ["slow", *SLOW])
@pytest.mark.slow
def test_the_root_is_where_a_long_swim_from_rest_ends(name):
    model, f = made(GAITS[name]), jnp.asarray(GAITS[name].frequency)
    found, long = search(model, f), swim(model, f)
    print(f"root {float(found.speed):.6f} m/s, swum {float(long.speed):.6f}")
    assert bool(found.ok) and abs(float(found.change)) < 5e-3 * float(found.speed)
    assert abs(float(long.acceleration)) < 1e-3
    np.testing.assert_allclose(found.speed, long.speed, rtol=1e-3)


@pytest.mark.slow
def test_the_search_ends_when_the_next_correction_is_small():
    """A batch gives the speeds and the numbers of strides of single robots; one robot fails."""
    gaits = [*GAITS.values(), GAITS["slow"]._replace(front=np.nan)]
    models, f = [made(x) for x in gaits], jnp.array([x.frequency for x in gaits])
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *models)
    found = jax.jit(jax.vmap(lambda m, f: find_steady(m, f, SEARCH)))(stacked, f)
    full = SEARCH._replace(precision=0.0)
    whole = jax.jit(jax.vmap(lambda m, f: find_steady(m, f, full)))(stacked, f)
    assert found.ok.tolist() == whole.ok.tolist() == [True, True, True, False]
    most = SEARCH.settling + SEARCH.following * SEARCH.corrections
    assert whole.strides.tolist() == [most, most, most, SEARCH.settling]
    steps = (found.strides - SEARCH.settling) / SEARCH.following
    assert (steps == jnp.round(steps)).all() and (steps[:2] < SEARCH.corrections).all()
    assert steps[3] == 0 and (steps[:3] > 1).all()
    np.testing.assert_allclose(found.speed[:3], whole.speed[:3], rtol=1e-3)
    for i, model in enumerate(models[:2]):
        one = search(model, f[i])
        assert one.strides == found.strides[i]
        np.testing.assert_allclose(one.speed, found.speed[i], rtol=1e-9)
    coarse = SEARCH._replace(precision=1e9)
    assert jax.jit(lambda m, f: find_steady(m, f, coarse))(models[0], f[0]).strides >= 6


def test_the_acceleration_needs_two_strides():
    with pytest.raises(ValueError, match="following: given 1; allowed 2 or more"):
        find_steady(made(GAITS["slow"]), jnp.asarray(2.5), SEARCH._replace(following=1))


@pytest.mark.slow
def test_a_wave_towards_the_head_swims_tail_first():
    gait = GAITS["5 Hz"]._replace(phase=-0.4)
    found, ahead = (
        search(made(gait), jnp.asarray(5.0)),
        search(made(GAITS["5 Hz"]), jnp.asarray(5.0)),
    )
    assert bool(found.ok) and float(found.speed) < -0.1 < 0.1 < float(ahead.speed)
    np.testing.assert_allclose(found.pace.course @ jnp.array([1.0, 0.0]), 1.0, atol=0.02)


@pytest.mark.slow
def test_a_delay_of_both_chambers_changes_no_speed():
    """However long it is: the drive has long begun."""
    model, f = made(GAITS["5 Hz"]), jnp.asarray(5.0)
    speeds = [
        float(search(replace(model, effects=(*model.effects, ValveDelay(jnp.asarray(x)))), f).speed)
        for x in (0.0, 0.03)
    ]
    assert speeds[0] > 0.1 and speeds[1] == pytest.approx(speeds[0], rel=2e-3)


@pytest.mark.slow
def test_a_bent_body_is_steady_on_a_circle():
    model, f = made(GAITS["5 Hz"]), jnp.asarray(5.0)
    model = replace(model, effects=(*model.effects, RestCurvature(jnp.asarray(0.3))))
    found, long = search(model, f), swim(model, f)
    stride = jax.jit(lambda m, c: next_stride(m, f, c, SEARCH))(model, found.carry)
    turning = float(performance(model, f, stride, SEARCH).turning)
    print(f"root {float(found.speed):.6f} m/s, swum {float(long.speed):.6f}, {turning:.3f} rad")
    assert bool(found.ok) and abs(turning) > 0.005
    np.testing.assert_allclose(found.speed, long.speed, rtol=2e-3)
    assert abs(float(long.acceleration)) < 2e-3


@pytest.mark.slow
def test_a_body_that_nothing_resists_finds_no_steady_speed():
    model = made(GAITS["optimum"], 0.0)
    found = search(model, jnp.asarray(GAITS["optimum"].frequency))
    assert float(found.speed) > 0.8 and not bool(found.ok)


@pytest.mark.slow
def test_a_body_made_faster_moves_faster_everywhere_and_in_no_other_way():
    model = made(GAITS["optimum"])
    carry, _ = simulate_strides(model, jnp.asarray(6.3), at_rest(model, SEARCH.numerics), 2, SEARCH)
    change = jnp.array([0.1, -0.05])
    faster = with_added_velocity(carry, change)
    for before, after in ((carry.memory.motion, faster.memory.motion),
                          (carry.history[-1, 3:], faster.history[-1, 3:])):  # fmt: skip
        c, s = np.cos(before[2]), np.sin(before[2])
        V = np.stack([c * before[0] - s * before[1], s * before[0] + c * before[1]])
        W = np.stack([c * after[0] - s * after[1], s * after[0] + c * after[1]])
        np.testing.assert_allclose(W - V, np.broadcast_to(change[:, None], V.shape), atol=1e-12)
        np.testing.assert_array_equal(before[2], after[2])
    np.testing.assert_array_equal(carry.history[:, :3], faster.history[:, :3])


@pytest.mark.slow
def test_its_derivative_is_that_of_the_root():
    """To the six variables of the design; the phase is off the steps, where the drive bends."""
    plan = SEARCH._replace(settling=10, of_derivatives=10)

    def speed(x):
        return steady_speed(made(Gait(*x)), x[0], plan)

    x0 = jnp.array(list(GAITS["optimum"]))
    value, slopes = jax.jit(lambda x: (speed(x), jax.jacfwd(speed)(x)))(x0)
    speed = jax.jit(speed)
    for i, name in enumerate(Gait._fields):
        h = 1e-4 * x0[i]
        numeric = (speed(x0.at[i].add(h)) - speed(x0.at[i].add(-h))) / (2.0 * h)
        print(f"{name}: {float(slopes[i]):.6g}, by differences {float(numeric):.6g}")
        np.testing.assert_allclose(slopes[i], numeric, rtol=1e-3, err_msg=name)
    assert 0.1 < float(value) < 0.5
