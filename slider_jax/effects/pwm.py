"""The firmware's valve law."""

import jax.numpy as jnp
from jaxtyping import Array

FULL = 25 * 932.8
"""Error [Pa] from which on the firmware opens a valve as far as it does: 10 a code, at most 250."""
WIDEST = 250.0 / 255.0
"""Duty of a valve that is open as far as the firmware opens it."""


def opening(error: Array, dead: Array) -> Array:
    """Share of full flow of the valve that an error [Pa] opens.

    The duty min(250, 10 |error in codes|)/255, of which the share `dead` opens nothing. Source:
    the public repository bvanstratum/SoftSnakePressureControl.
    """
    duty = WIDEST * jnp.minimum(jnp.abs(error) / FULL, 1.0)
    return jnp.maximum(duty - dead, 0.0) / (1.0 - dead)
