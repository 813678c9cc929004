"""Chambers that expand under pressure."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter

ATMOSPHERE = 101325.0
"""Atmospheric pressure p_a [Pa]."""


class ChamberExpansion(Flow):
    """A soft chamber expands, V = V_0 (1 + c |p|), so the same flow raises p less.

        dp/dt = (p_set - p)/k / (1 + c (p_a + 2 |p|))

    This follows from d((p_a + |p|) V)/dt = R_gas T dm/dt for the mass m of air at the constant
    temperature T. k is the time constant of a rigid chamber.
    Source: mass balance of a variable volume, Beater, P. (2007), Pneumatic Drives, Springer.
    """

    title = "chambers expand under pressure"
    order = 180

    expansion: Scalar = parameter(
        0.0, 0.0, 5e-6, "1/Pa", "an elastomer chamber at most doubles its volume at 200 kPa"
    )
    """c, relative increase of the volume per pressure."""

    def rate(self, rate, x):
        return rate / (1.0 + self.expansion * (ATMOSPHERE + 2.0 * jnp.abs(x.p)))
