"""The unknowns of the box method at the nodes, their names, and what time differentiates.

The array of unknowns has shape (6, N): component first, node last, so that all work is elementwise
along the contiguous node axis.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.grid import Grid

Unknowns = Float[Array, "6 nodes"]


class Fields(NamedTuple):
    """Names of the six rows: at nodes, in mid-cells, or their slopes d/ds, as the holder says."""

    T: Array
    """Axial force [N], positive in tension."""
    N: Array
    """Shear force [N] along n."""
    M: Array
    """Net internal moment [N m]: elastic, viscous and active together."""
    V_tau: Array
    """Velocity along the body, positive towards the head [m/s]."""
    V_n: Array
    """Velocity along n [m/s]."""
    phi: Array
    """Angle of tau from the x axis [rad]."""


def fields(y: Unknowns) -> Fields:
    """The six rows of `y` by name."""
    return Fields(*y)


class Memory(eqx.Module):
    """What the time derivatives act on: carried from step to step.

    `motion` (3, N): V_tau, V_n, phi at the nodes. `strain` (N - 1,): eps in the cells. `head` (2,):
    its position [m]. `load` (3,): T, N, M at the head, lagging as a mounting does. `internal`:
    memories (N - 1,) of the effects that are bending moments, in their order.
    """

    motion: Float[Array, "3 nodes"]
    strain: Float[Array, " cells"]
    head: Float[Array, "2"]
    load: Float[Array, "3"]
    internal: tuple[Float[Array, " cells"], ...] = ()


def straight_state(
    s: Float[Array, " nodes"], V_tau=0.0, V_n=0.0, phi=0.0, omega=0.0
) -> tuple[Unknowns, Memory]:
    """Unloaded and straight at the angle `phi` [rad], the head at the origin, moving rigidly.

    `s` [m]: the nodes; (V_tau, V_n) [m/s]: velocity of the head; `omega` [rad/s]: turning rate.
    """
    zero = jnp.zeros_like(s)
    y = jnp.stack([zero, zero, zero, zero + V_tau, V_n + omega * (s - s[-1]), zero + phi])
    return y, Memory(motion=y[3:], strain=zero[1:], head=jnp.zeros(2), load=jnp.zeros(3))


def to_body(vector, phi):
    """Components (tau, n) of a plane vector (x, y) in a frame turned by `phi` [rad]."""
    x, y = vector
    c, s = jnp.cos(phi), jnp.sin(phi)
    return c * x + s * y, -s * x + c * y


def to_plane(tau, n, phi):
    """Components (x, y) of a vector given by (tau, n) in a frame turned by `phi` [rad]."""
    c, s = jnp.cos(phi), jnp.sin(phi)
    return c * tau - s * n, s * tau + c * n


def node_positions(
    phi: Float[Array, " nodes"], strain: Float[Array, " cells"], head: Float[Array, "2"], grid: Grid
) -> Float[Array, "2 nodes"]:
    """Node positions [m] from the angles, going back from the head: dr/ds = (1 + eps) tau."""
    angle = grid.mid(phi)
    step = (1.0 + strain) * grid.ds * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    behind = jnp.cumsum(step[:, ::-1], axis=1)[:, ::-1]
    return head[:, None] - jnp.concatenate([behind, jnp.zeros((2, 1), behind.dtype)], axis=1)
