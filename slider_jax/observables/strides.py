"""Series on a stride-locked time grid, a stride at a time."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar


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


def tail_excursion(tip_series: Float[Array, " times"]) -> Float[Array, ""]:
    """A [m], peak to peak: max - min of `tip` over whole strides; half of it is A_t."""
    return jnp.max(tip_series, axis=-1) - jnp.min(tip_series, axis=-1)


def strouhal_number(frequency: Scalar, excursion: Scalar, speed: Scalar) -> Scalar:
    """St = f A / U with A [m] the tail's peak-to-peak excursion, U [m/s] the swimming speed.

    Source: Triantafyllou, G. S., Triantafyllou, M. S., Grosenbaugh, M. A. (1993), J. Fluids
    Struct. 7, 205-224.
    """
    return frequency * excursion / speed


def froude_efficiency(mean_thrust: Scalar, speed: Scalar, mean_power: Scalar) -> Scalar:
    """eta = T U / P [-]: useful power over the mean mechanical power [W] of the chambers.

    For a towed clamp T [N] is the mean force on the clamp and U [m/s] the tow speed. Zero at U = 0,
    where `force_efficiency` is the measure. Source: Lighthill, M. J. (1960), J. Fluid
    Mech. 9, 305-317.
    """
    return mean_thrust * speed / mean_power


def force_efficiency(mean_thrust: Scalar, mean_power: Scalar) -> Scalar:
    """T / P [N/W]: mean thrust [N] per mean mechanical power [W] that the chambers put in.

    The measure of a robot held in place, where no useful power leaves it.
    """
    return mean_thrust / mean_power


def tail_slope(amplitude: Scalar, wavelength: Scalar) -> Scalar:
    """A_t / (lambda/4) [-]: how steeply the wave crosses the axis at the tail, as in the paper.

    `amplitude` A_t [m] is half the peak-to-peak excursion; lambda [m] the body wavelength.
    (The line from a zero to the crest; the sine itself is steeper there by pi/2.)
    """
    return amplitude / (wavelength / 4.0)
