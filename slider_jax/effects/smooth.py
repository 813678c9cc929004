"""Switches and limits of fixed sharpness, so that effects keep their tangents."""

import jax.numpy as jnp
from jaxtyping import Array

SHARP = 32
"""Exponent of a limit: at nine tenths of it 0.1 % are missing, at the limit itself 2 %."""


def magnitude(x: Array, width: float) -> Array:
    """|x|, rounded below `width`: sqrt(x^2 + width^2)."""
    return jnp.sqrt(x**2 + width**2)


def limited(x: Array, inverse: Array) -> Array:
    """x, held between -1/inverse and 1/inverse: x/(1 + |inverse x|^32)^(1/32)."""
    return x / (1.0 + (inverse * x) ** SHARP) ** (1.0 / SHARP)
