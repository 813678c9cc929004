"""Valves limited by sonic flow."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter


class ChokedFlow(Flow):
    """The rate of the pressure approaches a limit R smoothly.

        dp/dt = r/(1 + c |r|),    r = (p_set - p)/k

    r is the rate of the lag. |dp/dt| stays below R = 1/c. At sonic speed in the valve, the mass
    flow depends only on the upstream pressure. Source: ISO 6358-1 (2013), Pneumatic fluid power:
    determination of flow-rate characteristics of components.
    """

    title = "flow through the valves is choked"
    order = 90

    inverse: Scalar = parameter(0.0, 0.0, 1e-6, "s/Pa", "the limit R is at least 1 MPa/s")
    """c = 1/R. At k = 87 ms, a step from -250 to 250 kPa causes a rate r of 6 MPa/s."""

    def rate(self, rate, x):
        return rate / (1.0 + self.inverse * jnp.abs(rate))
