"""A supply that cannot hold the set pressure."""

import jax.numpy as jnp

from slider_jax.actuation.waveform import Shaped
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter


class SupplyLimit(Command):
    """The regulator's pressure droops as the set pressure approaches the supply pressure.

        p_set,valve = p_set/(1 + c |p_set|)

    The regulator's pressure never exceeds the supply pressure 1/c. Unlike a hard limit, the effect
    has a nonzero tangent at the null: -|p_set| p_set. Source: regulator droop, Andersen, B. W.
    (1967), The analysis and design of pneumatic systems, Wiley.
    """

    title = "the supply cannot reach the set pressure"
    order = 40

    inverse: Scalar = parameter(
        0.0, 0.0, 3e-6, "1/Pa", "a supply of 330 kPa halves the largest set pressure"
    )
    """c, inverse of the supply pressure."""

    def curve(self, p_set):
        """Returns the set pressure at the valves [Pa]."""
        return p_set / (1.0 + self.inverse * jnp.abs(p_set))

    def command(self, wave, chamber):
        return Shaped(wave, self.curve)
