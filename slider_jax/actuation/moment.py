"""Where a chamber bends the body: Peskin's regularised couples at its two ends."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.grid import Grid
from slider_jax.beam.parameters import Robot, Scalar


def peskin_delta(r):
    """Peskin's four-point regularised delta of a distance `r` in grid spacings.

    On a uniform grid its values sum to 1 and its first moment vanishes for every position.
    Source: Peskin, C. S. (2002), The immersed boundary method, Acta Numerica 11, eq. 6.27.
    """
    r = jnp.abs(r)
    inner = jnp.sqrt(jnp.maximum(1.0 + 4.0 * r - 4.0 * r**2, 0.25))
    outer = jnp.sqrt(jnp.maximum(-7.0 + 12.0 * r - 4.0 * r**2, 0.25))
    near, far = (3.0 - 2.0 * r + inner) / 8.0, (5.0 - 2.0 * r - outer) / 8.0
    return jnp.where(r < 1.0, near, jnp.where(r < 2.0, far, 0.0))


def spread(position: Scalar, grid: Grid) -> Float[Array, " nodes"]:
    """Weights at the nodes of a unit couple at `position` [m]: zeroth and first moment exact.

    Peskin's delta where its four nodes lie within tail or body, each of which is uniform; beside an
    end or the joint the two-point (linear) delta, whose moments are exact on any grid.
    """
    nodes = grid.s.shape[0]
    index = jnp.arange(nodes, dtype=grid.s.dtype)
    xi = jnp.interp(position, grid.s, index)
    cell = jnp.clip(jnp.floor(xi), 0.0, nodes - 2.0).astype(int)
    first, last = (
        jnp.where(cell < grid.tail_cells, 0, grid.tail_cells),
        jnp.where(cell < grid.tail_cells, grid.tail_cells, nodes - 1),
    )
    fits = (cell - 1 >= first) & (cell + 2 <= last)
    linear = jnp.maximum(0.0, 1.0 - jnp.abs(index - xi))
    return jnp.where(fits, peskin_delta(index - xi), linear)


def chamber_windows(robot: Robot, grid: Grid) -> Float[Array, "2 cells"]:
    """Share of each chamber's moment that acts in each cell: rows are the front and rear chamber.

    The paper's distributed moment is Q = d(M_act)/ds, two opposite couples K_Q p at the chamber's
    ends; M_act = K_Q (window_front p_front + window_rear p_rear).
    """

    def window(span):
        near, far = span
        couples = spread(robot.length - far, grid) - spread(robot.length - near, grid)
        return jnp.cumsum(couples)[:-1]

    return jnp.stack([window(robot.front_chamber), window(robot.rear_chamber)])
