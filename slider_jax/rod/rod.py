"""A rod in three dimensions, clamped at one end, and the shape that its curvatures give.

The arc length s runs from the clamp to the tip. The frame of a section has the axes t (tangent,
towards the tip), n and b = t x n. The curvature vector is the rate at which the frame turns along
the rod: twist about t, and bending about n and about b.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.rod.rotations import mean_rotation, rotation


class Rod(eqx.Module):
    """Properties of a rod in its cells, in SI units. `EA` is None for an inextensible rod."""

    ds: Float[Array, " cells"]
    """Unstretched lengths of the cells [m]."""
    stiffness: Float[Array, "cells 3"]
    """GJ, EI_n and EI_b [N m^2]: stiffness against twist, and against bending about n and b."""
    initial_curvature: Float[Array, "cells 3"]
    """Curvatures (t, n, b) [1/m] of the unloaded rod."""
    clamp: Float[Array, "3 3"]
    """The frame at the clamp; its columns are t, n and b."""
    weight: Float[Array, " cells"]
    """Weight per length [N/m] in the surrounding fluid."""
    EA: Float[Array, " cells"] | None = None
    """Axial stiffness [N]."""

    @property
    def unloaded(self) -> Float[Array, "cells q"]:
        """The strains q of the unloaded rod: three curvatures, and the strain unless EA is None."""
        zero = jnp.zeros_like(self.ds)[:, None]
        parts = [self.initial_curvature] if self.EA is None else [self.initial_curvature, zero]
        return jnp.concatenate(parts, axis=1)

    @property
    def elasticity(self) -> Float[Array, "cells q"]:
        """The stiffness of each strain."""
        if self.EA is None:
            return self.stiffness
        return jnp.concatenate([self.stiffness, self.EA[:, None]], axis=1)

    @property
    def s(self) -> Float[Array, " cells"]:
        """Distance [m] of the middle of each cell from the clamp."""
        return jnp.cumsum(self.ds) - 0.5 * self.ds


class RodShape(NamedTuple):
    """Shape of a rod; the clamp is at the origin."""

    position: Float[Array, "nodes 3"]
    """Positions of the nodes [m], clamp first."""
    frame: Float[Array, "nodes 3 3"]
    """Frames at the nodes; the columns are t, n and b."""


def stretch_of(strains: Float[Array, "cells q"]) -> Float[Array, " cells"]:
    """Returns 1 + eps in each cell, where eps is the fourth strain, or zero."""
    if strains.shape[1] == 3:
        return jnp.ones_like(strains[:, 0])
    return 1.0 + strains[:, 3]


def rod_shape(rod: Rod, strains: Float[Array, "cells q"]) -> RodShape:
    """Returns the shape of a rod with constant strains in each cell; exact for such strains."""
    turn = strains[:, :3] * rod.ds[:, None]
    chord = jax.vmap(mean_rotation)(turn)[:, :, 0] * (stretch_of(strains) * rod.ds)[:, None]

    def pass_cell(state, cell):
        position, frame = state
        turning, ahead = cell
        after = position + frame @ ahead, frame @ turning
        return after, after

    start = jnp.zeros(3, turn.dtype), rod.clamp
    _, (position, frame) = jax.lax.scan(pass_cell, start, (jax.vmap(rotation)(turn), chord))
    return RodShape(
        jnp.concatenate([start[0][None], position]), jnp.concatenate([start[1][None], frame])
    )
