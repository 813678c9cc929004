"""The supports of a rod that is held at both ends.

The far end has a given place, and, in a clamp, a given direction. A hinge lets it turn. The near
end may be a hinge too: its support exerts a moment only along t of the clamp, and its rate of
turning has no part along t.

The end moves from its place at the unloaded rod to the given place in proportion to the share of
the loads. A straight rod that is pushed together has no unique shape. So the unloaded rod gets a
small extra curvature, which vanishes with the last share.
"""

from typing import Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from slider_jax.rod.rod import Rod, RodShape, rod_shape
from slider_jax.rod.rotations import axis_of, rotation

BOW = 0.1
"""Largest slope [rad] of the bowed rod relative to the unloaded rod. Twice, L/4 from each end."""


class HeldEnd(eqx.Module):
    """Supports of a rod that is held at both ends, and the way of the far end to its place."""

    position: Float[Array, "3"]
    """Place [m] of the far end."""
    frame: Float[Array, "3 3"]
    """Frame at the far end; its columns are t, n and b."""
    held: Float[Array, "k 3"]
    """Unit vectors along which the far end cannot move."""
    turning_held: Float[Array, "m 3"]
    """Unit vectors about which the far end cannot turn: three in a clamp, none in a hinge."""
    near_axes: Float[Array, "3 h"]
    """Unit vectors about which the near end can turn, as columns: n and b, or none in a clamp."""
    way: Float[Array, "3"]
    """Displacement [m] of the far end from its place in the unloaded, bowed rod to `position`."""
    turn: Float[Array, "3"]
    """Rotation vector [rad] from the frame at the unloaded rod to `frame`."""
    turns: Float[Array, ""]
    """Further turns of the far end about its tangent."""
    bow: Float[Array, "points 3"]
    """Extra curvature [1/m] of the unloaded rod, which vanishes with the last share."""

    def at(self, share) -> Self:
        """Returns the supports at a share of the way."""
        left = 1.0 - share
        ahead = rotation(jnp.array([1.0, 0.0, 0.0]) * (2.0 * jnp.pi * self.turns * share))
        return eqx.tree_at(
            lambda x: (x.position, x.frame, x.bow),
            self,
            (
                self.position - left * self.way,
                self.frame @ rotation(-left * self.turn) @ ahead,
                left * self.bow,
            ),
        )

    def error(self, shape: RodShape) -> Float[Array, " k_and_m"]:
        """Returns displacements [m] and turns [rad] of the far end along the held axes."""
        turning = shape.frame[-1] @ self.frame.T
        # 2 tan(angle/2) along the axis: a small angle itself, and not zero at half a turn.
        turned = 4.0 / (1.0 + jnp.trace(turning)) * axis_of(turning)
        away = self.held @ (shape.position[-1] - self.position)
        return jnp.concatenate([away, self.turning_held @ turned])

    def pull(
        self, multipliers: Float[Array, " k_and_m"]
    ) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        """Returns force [N] and moment [N m] on the far end from their parts along the axes."""
        along = len(self.held)
        return multipliers[:along] @ self.held, multipliers[along:] @ self.turning_held


def held_end(
    rod: Rod,
    position: np.ndarray,
    frame: np.ndarray | None,
    turns: float = 0.0,
    slides_along: np.ndarray | None = None,
    near_hinge: bool = False,
) -> HeldEnd:
    """Returns the supports; `frame` is None for a hinge at the far end.

    The end can slide along the direction `slides_along`.
    """
    length = jnp.sum(rod.ds)
    bend = 2.0 * jnp.pi / length * BOW * jnp.cos(2.0 * jnp.pi * rod.s / length)
    soft = 1 + int(jnp.sum(rod.stiffness[:, 2]) <= jnp.sum(rod.stiffness[:, 1]))
    bow = jnp.zeros_like(rod.initial_curvature).at[:, soft].set(bend)
    bowed = eqx.tree_at(lambda x: x.initial_curvature, rod, rod.initial_curvature + bow)
    tip = rod_shape(bowed, bowed.unloaded)
    begin, axes = np.asarray(tip.position[-1]), np.asarray(tip.frame[-1])
    end = axes if frame is None else frame
    held = np.eye(3)
    if slides_along is not None:
        held = np.linalg.svd(np.asarray(slides_along)[None])[2][1:]
    return HeldEnd(
        position=jnp.asarray(position),
        frame=jnp.asarray(end),
        held=jnp.asarray(held),
        turning_held=jnp.eye(3) if frame is not None else jnp.zeros((0, 3)),
        near_axes=rod.clamp[:, 1:] if near_hinge else jnp.zeros((3, 0)),
        way=jnp.asarray(position - begin),
        turn=jnp.asarray(Rotation.from_matrix(axes.T @ end).as_rotvec()),
        turns=jnp.asarray(turns),
        bow=bow,
    )
