"""The spatial grid: nodes from the tail (s = 0) to the head (s = L), and cells between the nodes.

All cells of the tail are equally long, and all cells of the body are equally long. The joint is
always a node, so no cell belongs to both. The numbers of cells are static, so the positions of the
nodes are differentiable with respect to a length, such as the tail length.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Grid(eqx.Module):
    """Nodes and cells of the box method.

    `s` [m] contains the positions of N nodes, `ds` [m] the lengths of N - 1 cells. Node 0 is the
    tail tip; node N - 1 is the head.
    """

    s: Float[Array, " nodes"]
    ds: Float[Array, " cells"]
    tail_cells: int = eqx.field(static=True)

    def mid(self, x: Float[Array, "*b nodes"]) -> Float[Array, "*b cells"]:
        """Returns the mean of the values at the two nodes of each cell."""
        return 0.5 * (x[..., 1:] + x[..., :-1])

    def slope(self, x: Float[Array, "*b nodes"]) -> Float[Array, "*b cells"]:
        """Returns the slope d/ds in each cell."""
        return (x[..., 1:] - x[..., :-1]) / self.ds

    def integral(self, cell_values: Float[Array, "*b cells"]) -> Float[Array, "*b"]:
        """Returns the integral of a cell quantity over the body (midpoint rule)."""
        return jnp.sum(cell_values * self.ds, axis=-1)

    def per_cell(self, tail, body) -> Float[Array, " cells"]:
        """Returns a cell quantity that equals `tail` in the tail and `body` in the body."""
        return jnp.where(jnp.arange(self.ds.shape[-1]) < self.tail_cells, tail, body)

    def at_joint(self) -> Float[Array, " cells"]:
        """Returns a unit Dirac delta at the joint [1/m], distributed to the two adjacent cells.

        The zeroth and first moments of the delta are exact. Without a joint, the delta is zero.
        """
        joint = self.tail_cells
        zero = jnp.zeros_like(self.ds)
        if not 0 < joint < self.ds.shape[-1]:
            return zero
        tail, body = self.ds[joint - 1], self.ds[joint]
        behind, before = body / tail / (tail + body), tail / body / (tail + body)
        return zero.at[joint - 1].set(behind).at[joint].set(before)


def make_grid(tail_length, body_length, tail_cells: int, body_cells: int) -> Grid:
    """Returns the grid of a body and a tail of the given lengths [m]."""
    tail = jnp.linspace(0.0, 1.0, tail_cells + 1)[:-1] * tail_length
    body = tail_length + jnp.linspace(0.0, 1.0, body_cells + 1) * body_length
    s = jnp.concatenate([tail, body])
    ds = jnp.where(
        jnp.arange(tail_cells + body_cells) < tail_cells,
        tail_length / max(tail_cells, 1),
        body_length / body_cells,
    )
    return Grid(s=s, ds=ds, tail_cells=tail_cells)


def split_cells(nodes: int, tail_length: float, body_length: float) -> tuple[int, int]:
    """Returns the numbers of cells of tail and body, in proportion to their lengths [m].

    Their sum is `nodes` - 1. Each number is at least 2, but a tail of zero length has no cells.
    """
    cells = nodes - 1
    tail = round(cells * tail_length / (tail_length + body_length))
    tail = 0 if tail_length == 0 else min(max(tail, 2), cells - 2)
    return tail, cells - tail
