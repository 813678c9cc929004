"""A rod in three dimensions, and the shape that its curvatures give.

The arc length s runs from the clamp to the tip. The frame of a section has the axes t (tangent,
towards the tip), n and b = t x n. The curvature vector is the rate at which the frame turns along
the rod: twist about t, and bending about n and about b.

The rod consists of cells. Strains and properties are given at the two Gauss points of each cell,
and vary linearly in the cell. Each point stands for one half of its cell.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.rod.rotations import mean_rotation, rotation

GAUSS = 1.0 / np.sqrt(3.0)
"""Distance of the Gauss points from the middle of a cell, divided by half its length."""
OWN, OTHER = 0.5 + GAUSS, 0.5 - GAUSS
"""Weights of both points in the constant strain that replaces the linear one in half a cell."""


def gauss_points(edges: np.ndarray) -> np.ndarray:
    """Returns the places [m] of the Gauss points, two in each cell; `edges` [m] bound the cells."""
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    return np.stack([middle - GAUSS * half, middle + GAUSS * half], axis=1).ravel()


def half_cells(edges: np.ndarray) -> np.ndarray:
    """Returns the ends and middles [m] of the cells; `edges` [m] bound the cells."""
    halves = np.repeat(edges, 2)[:-1]
    halves[1::2] = 0.5 * (edges[1:] + edges[:-1])
    return halves


class Rod(eqx.Module):
    """Properties of a rod at its points, in SI units. `EA` is None for an inextensible rod."""

    ds: Float[Array, " points"]
    """Unstretched lengths [m] of the half cells; both halves of a cell are equally long."""
    stiffness: Float[Array, "points 3"]
    """GJ, EI_n and EI_b [N m^2]: stiffness against twist, and against bending about n and b."""
    initial_curvature: Float[Array, "points 3"]
    """Curvatures (t, n, b) [1/m] of the unloaded rod."""
    clamp: Float[Array, "3 3"]
    """The frame at the clamp; its columns are t, n and b."""
    weight: Float[Array, " points"]
    """Weight per length [N/m] in the surrounding fluid."""
    EA: Float[Array, " points"] | None = None
    """Axial stiffness [N]."""

    @property
    def unloaded(self) -> Float[Array, "points q"]:
        """The strains q of the unloaded rod: three curvatures, and the strain unless EA is None."""
        zero = jnp.zeros_like(self.ds)[:, None]
        parts = [self.initial_curvature] if self.EA is None else [self.initial_curvature, zero]
        return jnp.concatenate(parts, axis=1)

    @property
    def elasticity(self) -> Float[Array, "points q"]:
        """The stiffness of each strain."""
        if self.EA is None:
            return self.stiffness
        return jnp.concatenate([self.stiffness, self.EA[:, None]], axis=1)

    @property
    def s(self) -> Float[Array, " points"]:
        """Distance [m] of each point from the clamp."""
        inwards = jnp.tile(jnp.array([1.0, -1.0]), len(self.ds) // 2) * (0.5 - GAUSS) * self.ds
        return jnp.cumsum(self.ds) - 0.5 * self.ds + inwards


class RodShape(NamedTuple):
    """Shape of a rod; the clamp is at the origin."""

    position: Float[Array, "nodes 3"]
    """Positions [m] of the nodes, the ends of the cells; the clamp first."""
    frame: Float[Array, "nodes 3 3"]
    """Frames at the nodes; the columns are t, n and b."""


def stretch_of(strains: Float[Array, "points q"]) -> Float[Array, " points"]:
    """Returns 1 + eps at each point, where eps is the fourth strain, or zero."""
    if strains.shape[1] == 3:
        return jnp.ones_like(strains[:, 0])
    return 1.0 + strains[:, 3]


def cell_motions(
    rod: Rod, strains: Float[Array, "points q"]
) -> tuple[Float[Array, "cells 3 3"], Float[Array, "cells 3"]]:
    """Returns turn and displacement [m] of the far end of each cell, in the frame at its near end.

    Strains are linear in each cell. The error is of fourth order in the length of the cell, and
    zero for constant strains. Source: commutator-free scheme with
    two exponentials, Celledoni, Marthinsen & Owren (2003), Future Gener. Comput. Syst. 19, 341.
    """
    pairs = strains.reshape(-1, 2, strains.shape[1])
    mixed = (OWN * pairs + OTHER * pairs[:, ::-1]).reshape(strains.shape)
    turn = mixed[:, :3] * rod.ds[:, None]
    turning = jax.vmap(rotation)(turn)
    chord = jax.vmap(mean_rotation)(turn)[:, :, 0] * (stretch_of(mixed) * rod.ds)[:, None]
    first, second = turning[::2], turning[1::2]
    return first @ second, chord[::2] + jnp.einsum("kij,kj->ki", first, chord[1::2])


def rod_shape(rod: Rod, strains: Float[Array, "points q"]) -> RodShape:
    """Returns the shape of a rod; of fourth order in the length of the cells."""
    turning, ahead = cell_motions(rod, strains)

    def pass_cell(frame, turning):
        after = frame @ turning
        return after, after

    _, frame = jax.lax.scan(pass_cell, rod.clamp, turning)
    frame = jnp.concatenate([rod.clamp[None], frame])
    position = jnp.cumsum(jnp.einsum("kij,kj->ki", frame[:-1], ahead), axis=0)
    return RodShape(jnp.concatenate([jnp.zeros((1, 3), position.dtype), position]), frame)
