"""The unknowns of the box method at the nodes, the state between steps, and the body frame.

The array of unknowns has shape (6, N). The last axis contains the N nodes and is contiguous in
memory. In the body frame, tau points towards the head and n is tau rotated by +90 degrees.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.grid import Grid

Unknowns = Float[Array, "6 nodes"]


class Fields(NamedTuple):
    """The six unknowns by name: values at nodes, or means or slopes d/ds in cells."""

    T: Array
    """Axial force [N], positive in tension."""
    N: Array
    """Shear force [N] along n."""
    M: Array
    """Net internal moment [N m]: the sum of elastic, viscous and active moments."""
    V_tau: Array
    """Velocity along tau [m/s], positive towards the head."""
    V_n: Array
    """Velocity along n [m/s]."""
    phi: Array
    """Angle [rad] from the x axis to tau."""


def fields(y: Unknowns) -> Fields:
    """Returns the six unknowns in `y` by name."""
    return Fields(*y)


class Memory(eqx.Module):
    """Values that one step passes to the next step, to compute time derivatives.

    `motion` (3, N): V_tau [m/s], V_n [m/s] and phi [rad] at the nodes. `strain` (N - 1,): eps [-]
    in the cells. `head` (2,): position [m] of the head. `load` (3,): T, N, M at the head, filtered
    with the time constant `MOUNT_LAG`. `internal`: state (..., N - 1) of each effect that has a
    state in the cells. `support`: state of the support; None for a support without a state.
    """

    motion: Float[Array, "3 nodes"]
    strain: Float[Array, " cells"]
    head: Float[Array, "2"]
    load: Float[Array, "3"]
    internal: tuple[Float[Array, "*states cells"], ...] = ()
    support: Any = None


def straight_state(
    s: Float[Array, " nodes"], V_tau=0.0, V_n=0.0, phi=0.0, omega=0.0
) -> tuple[Unknowns, Memory]:
    """Returns the state of an unloaded straight body in rigid motion, with its head at the origin.

    `s` [m]: positions of the nodes along the body. (V_tau, V_n) [m/s]: velocity of the head.
    `phi` [rad] and `omega` [rad/s]: angle and turning rate of the body.
    """
    zero = jnp.zeros_like(s)
    y = jnp.stack([zero, zero, zero, zero + V_tau, V_n + omega * (s - s[-1]), zero + phi])
    return y, Memory(motion=y[3:], strain=zero[1:], head=jnp.zeros(2), load=jnp.zeros(3))


def curved_state(
    grid: Grid,
    V_tau,
    V_n,
    phi,
    omega,
    kappa: Float[Array, " cells"],
    kappa_t: Float[Array, " cells"],
) -> tuple[Unknowns, Memory]:
    """Returns an unloaded state with the curvature `kappa` [1/m] and its rate `kappa_t` [1/(m s)].

    (V_tau, V_n) [m/s], `phi` [rad] and `omega` [rad/s] are the motion of the head, which is at the
    origin. The body is not stretched. The velocities satisfy the equations of stretch and turn.
    """

    def from_head(at_head, rate):
        behind = jnp.cumsum((rate * grid.ds)[::-1])[::-1]
        return at_head - jnp.concatenate([behind, jnp.zeros(1, behind.dtype)])

    turning = from_head(omega, kappa_t)

    def behind(right, cell):
        half, turned = cell
        p, q = right[0] - half * right[1], right[1] + half * right[0] - turned
        left = jnp.stack([p - half * q, q + half * p]) / (1.0 + half**2)
        return left, left

    at_head = jnp.stack([jnp.asarray(V_tau, float), jnp.asarray(V_n, float)])
    cells = 0.5 * kappa * grid.ds, grid.mid(turning) * grid.ds
    _, velocities = jax.lax.scan(behind, at_head, cells, reverse=True)
    velocities = jnp.concatenate([velocities, at_head[None]])
    motion = jnp.concatenate([velocities.T, from_head(phi, kappa)[None]])
    memory = Memory(motion, jnp.zeros_like(kappa), jnp.zeros(2), jnp.zeros(3))
    return jnp.concatenate([jnp.zeros_like(motion), motion]), memory


def to_body(vector, phi):
    """Returns the components (tau, n) of the vector (x, y) in a frame rotated by `phi` [rad]."""
    x, y = vector
    c, s = jnp.cos(phi), jnp.sin(phi)
    return c * x + s * y, -s * x + c * y


def to_plane(tau, n, phi):
    """Returns (x, y) of a vector with components (tau, n) in a frame rotated by `phi` [rad]."""
    c, s = jnp.cos(phi), jnp.sin(phi)
    return c * tau - s * n, s * tau + c * n


def node_positions(
    phi: Float[Array, " nodes"], strain: Float[Array, " cells"], head: Float[Array, "2"], grid: Grid
) -> Float[Array, "2 nodes"]:
    """Returns node positions r [m], integrated backwards from the head: dr/ds = (1 + eps) tau."""
    angle = grid.mid(phi)
    step = (1.0 + strain) * grid.ds * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    behind = jnp.cumsum(step[:, ::-1], axis=1)[:, ::-1]
    return head[:, None] - jnp.concatenate([behind, jnp.zeros((2, 1), behind.dtype)], axis=1)
