"""Valves limited by sonic flow."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter


class ChokedFlow(Flow):
    """The rate of the pressure approaches a largest rate smoothly.

        dp/dt = r/(1 + c |r|),    r = (p_set - p)/k

    |dp/dt| stays below R = 1/c. At sonic speed in the valve, the mass flow depends only on the
    upstream pressure and no longer increases with the pressure difference. Source: ISO 6358-1
    (2013), Pneumatic fluid power: determination of flow-rate characteristics of components.
    """

    title = "flow through the valves is choked"
    order = 90

    inverse: Scalar = parameter(
        0.0, 0.0, 1e-6, "s/Pa", "reversing 250 kPa at k = 87 ms needs 6 MPa/s; R is 1 MPa/s or more"
    )
    """c = 1/R, the inverse of the largest rate."""

    def rate(self, rate, x):
        return rate / (1.0 + self.inverse * jnp.abs(rate))
