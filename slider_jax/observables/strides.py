"""Computes means over each stride, and efficiencies, the Strouhal number and the tail slope."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar


def stride_means(
    series: Float[Array, "*b steps"], steps_per_stride: int
) -> Float[Array, "*b strides"]:
    """Returns the mean of `series` over each stride; time is the last axis."""
    steps = series.shape[-1]
    if steps % steps_per_stride:
        raise ValueError(
            f"stride statistics: given {steps} steps; allowed a multiple of {steps_per_stride}, "
            "the steps per stride; cut the series to whole strides (time is the last axis)"
        )
    return jnp.mean(series.reshape(*series.shape[:-1], -1, steps_per_stride), axis=-1)


def strouhal_number(frequency: Scalar, excursion: Scalar, speed: Scalar) -> Scalar:
    """Returns St = f A / U [-] from the tail's peak-to-peak excursion A [m] and the speed U [m/s].

    Source: Triantafyllou, G. S., Triantafyllou, M. S., Grosenbaugh, M. A. (1993), J. Fluids
    Struct. 7, 205-224.
    """
    return frequency * excursion / speed


def froude_efficiency(mean_thrust: Scalar, speed: Scalar, mean_power: Scalar) -> Scalar:
    """Returns eta = T U / P [-]: useful power divided by the chambers' mean mechanical power P [W].

    For a towed clamp, T [N] is the mean force on the clamp and U [m/s] is the tow speed. Since eta
    is zero at U = 0, use `force_efficiency` for a robot that is held in place. Source: Lighthill,
    M. J. (1960), J. Fluid Mech. 9, 305-317.
    """
    return mean_thrust * speed / mean_power


def force_efficiency(mean_thrust: Scalar, mean_power: Scalar) -> Scalar:
    """Returns T / P [N/W]: mean thrust [N] divided by the chambers' mean mechanical power [W].

    Use this number for a robot that is held in place, because the useful power T U is zero.
    """
    return mean_thrust / mean_power


def tail_slope(amplitude: Scalar, wavelength: Scalar) -> Scalar:
    """Returns the paper's slope A_t / (lambda/4) [-] of the wave at the tail.

    `amplitude` A_t [m] is half the peak-to-peak excursion; lambda [m] is the body wavelength. A
    straight line from a zero of the wave to the next crest has this slope. At the zero, a sine wave
    is steeper than this line by the factor pi/2.
    """
    return amplitude / (wavelength / 4.0)
