"""Rotations in space: rotation vectors and rotation matrices.

The columns of a matrix are the axes of the rotated frame. A rotation vector is the axis of the
rotation times its angle [rad].
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

_SMALL = 1e-4
"""Squared angle [rad^2] below which power series replace the closed forms."""


def cross_matrix(v: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Returns the matrix of the cross product: cross_matrix(v) @ w = v x w."""
    zero = jnp.zeros_like(v[0])
    return jnp.array([[zero, -v[2], v[1]], [v[2], zero, -v[0]], [-v[1], v[0], zero]])


def axis_of(m: Float[Array, "... 3 3"]) -> Float[Array, "... 3"]:
    """Returns v of the skew part of a matrix, which is cross_matrix(v)."""
    skew = 0.5 * (m - jnp.swapaxes(m, -1, -2))
    return jnp.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)


def _coefficients(v: Float[Array, "3"]) -> tuple[Array, Array, Array]:
    """Returns sin(x)/x, (1 - cos(x))/x^2 and (x - sin(x))/x^3 at the angle x = |v|."""
    square = v @ v
    small = square < _SMALL
    safe = jnp.where(small, 1.0, square)
    angle = jnp.sqrt(safe)
    sine, half = jnp.sin(angle) / angle, jnp.sin(0.5 * angle) / angle
    q = square
    return (
        jnp.where(small, 1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0)), sine),
        jnp.where(small, 0.5 - q / 24.0 * (1.0 - q / 30.0 * (1.0 - q / 56.0)), 2.0 * half**2),
        jnp.where(
            small, 1 / 6 - q / 120.0 * (1.0 - q / 42.0 * (1.0 - q / 72.0)), (1 - sine) / safe
        ),
    )


def rotation(v: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Returns the rotation matrix exp(v x) of the rotation vector `v` [rad] (Rodrigues)."""
    first, second, _ = _coefficients(v)
    x = cross_matrix(v)
    return jnp.eye(3) + first * x + second * (x @ x)


def mean_rotation(v: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Returns the integral of exp(u v x) over u from 0 to 1.

    A piece of constant curvature turns by `v` from its near end to its far end. This matrix times
    the tangent at the near end is the chord of the piece divided by its length.
    """
    _, second, third = _coefficients(v)
    x = cross_matrix(v)
    return jnp.eye(3) + second * x + third * (x @ x)
