"""Different time constants for filling and venting."""

import math

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter


class FillVentAsymmetry(Flow):
    """A chamber vents more slowly or faster than the chamber fills.

        dp/dt = (p_set - p)/k        while |p| increases
        dp/dt = (p_set - p)/(r k)    while |p| decreases

    Source: charge and discharge of a volume, Beater, P. (2007), Pneumatic Drives, Springer.
    """

    title = "filling and venting take different times"
    order = 70

    ratio: Scalar = parameter(
        1.0,
        0.3,
        3.0,
        "-",
        "venting is up to three times slower or faster than filling",
        physical=(0.05, math.inf),
    )
    """r, time constant of venting divided by the time constant k of filling."""

    def rate(self, rate, x):
        return jnp.where(x.filling, rate, rate / self.ratio)
