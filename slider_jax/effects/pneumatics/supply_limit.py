"""A supply that cannot hold the set pressure."""

import jax.numpy as jnp

from slider_jax.actuation.waveform import Shaped
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter


class SupplyLimit(Command):
    """The regulator delivers less than the set pressure, because the supply pressure is limited.

        p_set,valve = p_set/(1 + c |p_set|)

    The delivered pressure never exceeds the supply pressure 1/c. At the null, the derivative with
    respect to c is -|p_set| p_set; it is zero for the hard limit `SupplyCap`. Source: regulator
    droop, Andersen, B. W. (1967), The analysis and design of pneumatic systems, Wiley.
    """

    title = "the supply cannot reach the set pressure"
    order = 40

    inverse: Scalar = parameter(
        0.0, 0.0, 3e-6, "1/Pa", "with a supply of 330 kPa, a set pressure of 330 kPa is halved"
    )
    """c, inverse of the supply pressure."""

    def curve(self, p_set):
        """Returns the set pressure at the valves [Pa]."""
        return p_set / (1.0 + self.inverse * jnp.abs(p_set))

    def command(self, wave, rear):
        return Shaped(wave, self.curve)
