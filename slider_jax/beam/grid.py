"""The spatial grid: nodes from the tail (s = 0) to the head (s = L), cells between them.

Tail and body are meshed separately, each uniformly, so that the joint is always on a node and every
cell has one bending stiffness. Lengths are traced, counts are static: a design variable such as the
tail's length moves the nodes smoothly and stays differentiable.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Grid(eqx.Module):
    """Nodes and cells of the box method.

    `s` [m] has shape (N,), `ds` [m] shape (N - 1,); node 0 is the tail's tip, node N - 1 the head.
    """

    s: Float[Array, " nodes"]
    ds: Float[Array, " cells"]
    tail_cells: int = eqx.field(static=True)

    def mid(self, x: Float[Array, "*b nodes"]) -> Float[Array, "*b cells"]:
        """Value in the middle of each cell: the mean of its two nodes."""
        return 0.5 * (x[..., 1:] + x[..., :-1])

    def slope(self, x: Float[Array, "*b nodes"]) -> Float[Array, "*b cells"]:
        """d/ds in each cell."""
        return (x[..., 1:] - x[..., :-1]) / self.ds

    def integral(self, cell_values: Float[Array, "*b cells"]) -> Float[Array, "*b"]:
        """Integral over the body of a quantity given per cell (midpoint rule)."""
        return jnp.sum(cell_values * self.ds, axis=-1)

    def per_cell(self, tail, body) -> Float[Array, " cells"]:
        """A cell quantity that is `tail` along the tail and `body` along the body."""
        cells = self.ds.shape[-1]
        in_tail = jnp.arange(cells) < self.tail_cells
        return jnp.where(in_tail, tail, body)

    def at_joint(self) -> Float[Array, " cells"]:
        """A unit at the joint [1/m], in the cells beside it: zeroth and first moment exact."""
        joint = self.tail_cells
        nothing = jnp.zeros_like(self.ds)
        if not 0 < joint < self.ds.shape[-1]:
            return nothing
        tail, body = self.ds[joint - 1], self.ds[joint]
        behind, before = body / tail / (tail + body), tail / body / (tail + body)
        return nothing.at[joint - 1].set(behind).at[joint].set(before)


def make_grid(tail_length, body_length, tail_cells: int, body_cells: int) -> Grid:
    """The grid of a body of `body_length` [m] with a tail of `tail_length` [m] behind it."""
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
    """Cells of tail and of body out of `nodes` - 1, in proportion to length, at least 2 each."""
    cells = nodes - 1
    tail = round(cells * tail_length / (tail_length + body_length))
    tail = 0 if tail_length == 0 else min(max(tail, 2), cells - 2)
    return tail, cells - tail
