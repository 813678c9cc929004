"""Computes the moment of a chamber: a couple at each end, regularised by Peskin's delta."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.grid import Grid
from slider_jax.beam.parameters import Robot, Scalar


def peskin_delta(r):
    """Returns Peskin's four-point regularised delta at the distance `r` [grid spacings].

    On a uniform grid, the values at the nodes add up to 1 and the first moment is exact.
    Source: Peskin, C. S. (2002), The immersed boundary method, Acta Numerica 11, eq. 6.27.
    """
    r = jnp.abs(r)
    inner = jnp.sqrt(jnp.maximum(1.0 + 4.0 * r - 4.0 * r**2, 0.25))
    outer = jnp.sqrt(jnp.maximum(-7.0 + 12.0 * r - 4.0 * r**2, 0.25))
    near, far = (3.0 - 2.0 * r + inner) / 8.0, (5.0 - 2.0 * r - outer) / 8.0
    return jnp.where(r < 1.0, near, jnp.where(r < 2.0, far, 0.0))


def spread(position: Scalar, grid: Grid) -> Float[Array, " nodes"]:
    """Returns the weights that distribute a unit couple at `position` [m] to the nodes.

    Peskin's delta requires a uniform grid, so it is used only if all four nodes are in the tail or
    all four are in the body. Otherwise, the weights are linear between the two nearest nodes. The
    zeroth and first moments of the weights are always exact.
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


def chamber_windows(robot: Robot, grid: Grid) -> Float[Array, "chambers cells"]:
    """Returns the moment of each chamber in each cell, as a fraction of K_Q p.

    Each chamber exerts two opposite couples K_Q p at its ends. The active moment is therefore the
    sum of K_Q p times the window of each chamber. The paper names only the place of one couple,
    "at the posterior adapter".
    """

    if not robot.chambers:
        return jnp.zeros((0, *grid.ds.shape))

    def window(span):
        near, far = span
        couples = spread(robot.length - far, grid) - spread(robot.length - near, grid)
        return jnp.cumsum(couples)[:-1]

    return jax.vmap(window)(jnp.asarray(robot.chambers))
