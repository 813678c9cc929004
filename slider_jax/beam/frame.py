"""The body frame in the plane: tau towards the head, n = tau turned by +90 degrees."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.grid import Grid


def to_body(vector, phi):
    """Components (tau, n) of a plane vector (x, y) in a frame turned by `phi` [rad]."""
    x, y = vector
    c, s = jnp.cos(phi), jnp.sin(phi)
    return c * x + s * y, -s * x + c * y


def to_plane(tau, n, phi):
    """Components (x, y) of a vector given by (tau, n) in a frame turned by `phi` [rad]."""
    c, s = jnp.cos(phi), jnp.sin(phi)
    return c * tau - s * n, s * tau + c * n


def midline(
    phi: Float[Array, " nodes"], strain: Float[Array, " cells"], head: Float[Array, "2"], grid: Grid
) -> Float[Array, "2 nodes"]:
    """Node positions [m] from the angles, going back from the head: dr/ds = (1 + eps) tau."""
    angle = grid.mid(phi)
    step = (1.0 + strain) * grid.ds * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    behind = jnp.cumsum(step[:, ::-1], axis=1)[:, ::-1]
    return head[:, None] - jnp.concatenate([behind, jnp.zeros((2, 1), behind.dtype)], axis=1)
