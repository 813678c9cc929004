"""The regularised couples of the chambers: moments exact for every position."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation.moment import chamber_windows, peskin_delta, spread
from slider_jax.beam.parameters import Numerics, grid_of, uniform_robot

ROBOT = uniform_robot(body_length=0.3, tail_length=0.07)
GRIDS = [Numerics(tail_cells=10, body_cells=40), Numerics(4, 12), Numerics(2, 7)]


def positions(grid):
    """All over the body, every node, and right beside the ends and the joint."""
    s, L = np.asarray(grid.s), float(grid.s[-1])
    joint = float(grid.s[grid.tail_cells])
    near = np.concatenate([[b - 1e-9, b - 1e-3, b + 1e-3, b + 1e-9] for b in (0.0, joint, L)])
    every = np.concatenate([np.linspace(0.0, L, 997), s, near])
    return jnp.asarray(every[(every >= 0.0) & (every <= L)])


@pytest.mark.parametrize("numerics", GRIDS, ids=lambda n: f"{n.nodes} nodes")
def test_couple_keeps_its_zeroth_and_first_moment_everywhere(numerics):
    grid = grid_of(ROBOT, numerics)
    at = positions(grid)
    weights = np.asarray(jax.jit(jax.vmap(spread, in_axes=(0, None)))(at, grid))
    zeroth = np.max(np.abs(weights.sum(axis=1) - 1.0))
    first = np.max(np.abs(weights @ np.asarray(grid.s) - np.asarray(at)))
    print(f"zeroth moment off {zeroth:.1e}, first off {first:.1e} m")
    assert zeroth < 1e-13 and first < 1e-14


def test_the_delta_is_peskins_four_point_delta():
    """Values at 0, 1/2 and 1, even and odd sums one half, and the sum of squares 3/8."""
    np.testing.assert_allclose(peskin_delta(jnp.array([0.0, 1.0, 2.0])), [0.5, 0.25, 0.0])
    x = np.linspace(0.0, 1.0, 37)[:, None]
    for values in np.asarray(jax.jit(peskin_delta)(jnp.arange(-3.0, 4.0) - x)):
        assert values[::2].sum() == pytest.approx(0.5, abs=1e-14)
        assert values[1::2].sum() == pytest.approx(0.5, abs=1e-14)
        assert (values**2).sum() == pytest.approx(0.375, abs=1e-14)


def test_couple_is_spread_over_four_nodes_away_from_the_ends():
    grid = grid_of(ROBOT, GRIDS[0])
    weights = np.asarray(spread(0.2003, grid))
    assert np.count_nonzero(weights > 0) == 4


@pytest.mark.parametrize("numerics", GRIDS, ids=lambda n: f"{n.nodes} nodes")
@pytest.mark.parametrize(
    "span", [(0.02, 0.145), (0.0, 0.3), (0.1, 0.37), (0.0, 0.37), (0.29, 0.31)]
)
def test_a_chamber_bends_the_body_along_its_whole_length(numerics, span):
    """The integral of M_act is K_Q p times the span, whichever way the span meets the grid."""
    robot = uniform_robot(
        body_length=0.3, tail_length=0.07, front_chamber=span, rear_chamber=(0.155, 0.28)
    )
    grid = grid_of(robot, numerics)
    front, rear = chamber_windows(robot, grid) @ grid.ds
    assert float(front) == pytest.approx(span[1] - span[0], abs=1e-14)
    assert float(rear) == pytest.approx(0.125, abs=1e-14)


def test_the_window_is_one_inside_and_zero_outside():
    robot = uniform_robot(body_length=0.3, tail_length=0.07, front_chamber=(0.02, 0.145))
    grid = grid_of(robot, Numerics(tail_cells=28, body_cells=120))
    from_head = robot.length - np.asarray(grid.mid(grid.s))
    front, _ = np.asarray(chamber_windows(robot, grid))
    edge = 2.5 * 0.3 / 120
    np.testing.assert_allclose(front[(from_head > 0.02 + edge) & (from_head < 0.145 - edge)], 1.0)
    np.testing.assert_allclose(
        front[(from_head < 0.02 - edge) | (from_head > 0.145 + edge)], 0.0, atol=1e-14
    )


def test_the_window_is_differentiable_in_the_span_on_and_off_nodes():
    grid = grid_of(ROBOT, GRIDS[0])
    for near in (0.06, float(ROBOT.length - grid.s[30])):

        def bend(near):
            robot = uniform_robot(body_length=0.3, tail_length=0.07, front_chamber=(near, 0.145))
            return chamber_windows(robot, grid)[0] @ grid.ds

        assert float(jax.jit(jax.grad(bend))(near)) == pytest.approx(-1.0, abs=1e-9)
