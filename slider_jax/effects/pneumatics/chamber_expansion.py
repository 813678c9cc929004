"""Chambers that expand under pressure."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter

ATMOSPHERE = 101325.0
"""Atmospheric pressure p_a [Pa]."""


class ChamberExpansion(Flow):
    """A soft chamber expands under pressure, so the same air flow changes the pressure less.

        dp/dt = (p_set - p)/k / (1 + c (p_a + 2 |p|))

    V_0 (1 + c |p|) is the volume V, p_a the atmospheric pressure and k the time constant of a rigid
    chamber of the volume V_0. The mass flow of the air is proportional to d((p_a + |p|) V)/dt.
    Source: mass balance of a variable volume, Beater, P. (2007), Pneumatic Drives, Springer.
    """

    title = "chambers expand under pressure"
    order = 180

    expansion: Scalar = parameter(
        0.0, 0.0, 5e-6, "1/Pa", "the volume of an elastomer chamber doubles at most at 200 kPa"
    )
    """c, relative increase of the volume per pressure."""

    def rate(self, rate, x):
        return rate / (1.0 + self.expansion * (ATMOSPHERE + 2.0 * jnp.abs(x.p)))
