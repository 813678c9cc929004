"""The body's shape in the plane, and how far its tail swings."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam import frame
from slider_jax.dynamics.step import Snapshot


def midline(x: Snapshot) -> Float[Array, "2 nodes"]:
    """(x, y) of the nodes [m] in the plane, tail first."""
    return frame.midline(x.y[5], x.memory.strain, x.head, x.mesh.grid)


def lateral(x: Snapshot) -> Float[Array, " nodes"]:
    """y of the nodes less y of the head [m], tail first: what a camera on the carriage sees."""
    y = midline(x)[1]
    return y - y[-1]


def tip(x: Snapshot) -> Float[Array, ""]:
    """Lateral position of the tail's tip less that of the head [m]."""
    return lateral(x)[0]


def tail_excursion(tip_series: Float[Array, " times"]) -> Float[Array, ""]:
    """A [m], peak to peak: max - min of `tip` over whole strides; half of it is A_t."""
    return jnp.max(tip_series, axis=-1) - jnp.min(tip_series, axis=-1)
