"""Smooth forms of switches, of fixed width, so that effects keep their tangents."""

import jax.numpy as jnp
from jaxtyping import Array


def magnitude(x: Array, width: float) -> Array:
    """|x|, rounded below `width`: sqrt(x^2 + width^2)."""
    return jnp.sqrt(x**2 + width**2)


def filling(p: Array, p_set: Array) -> Array:
    """+1 where |p| [Pa] grows towards p_set, -1 where it falls; smooth over 20 kPa.

    The product of the signs of p and of p_set - p, each a tanh.
    """
    return jnp.tanh(p / 20e3) * jnp.tanh((p_set - p) / 20e3)
