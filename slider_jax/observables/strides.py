"""Series on a stride-locked time grid, a stride at a time."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def _by_stride(series, steps_per_stride: int):
    steps = series.shape[-1]
    if steps % steps_per_stride:
        raise ValueError(
            f"a series of {steps} steps is no whole number of strides of {steps_per_stride} steps; "
            "cut it to whole strides (time must be the last axis)"
        )
    return series.reshape(*series.shape[:-1], -1, steps_per_stride)


def stride_means(
    series: Float[Array, "*b steps"], steps_per_stride: int
) -> Float[Array, "*b strides"]:
    """Mean of each stride's steps: for a periodic series, the trapezoid rule."""
    return jnp.mean(_by_stride(series, steps_per_stride), axis=-1)


def stride_ranges(
    series: Float[Array, "*b steps"], steps_per_stride: int
) -> Float[Array, "*b strides"]:
    """Maximum less minimum over each stride."""
    strides = _by_stride(series, steps_per_stride)
    return jnp.max(strides, axis=-1) - jnp.min(strides, axis=-1)
