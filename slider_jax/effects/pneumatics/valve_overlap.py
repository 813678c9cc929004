"""Valves whose spool must move before they open."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter


class ValveOverlap(Flow):
    """The spool closes the valve below an error d, and reduces the flow above this error.

        dp/dt = sign(e) max(|e| - d, 0)/k,    e = p_set - p

    Source: overlap of a valve's spool, Beater, P. (2007), Pneumatic Drives, Springer.
    """

    title = "overlap of the valves"
    order = 120

    band: Scalar = parameter(0.0, 0.0, 40e3, "Pa", "up to 1/8 of the largest set pressure", 8e3)
    """d, the error below which the valve is closed."""

    def rate(self, rate, x):
        e = x.p_set - x.p
        left = jnp.maximum(jnp.abs(e) - self.band, 0.0)
        return rate * left / jnp.maximum(jnp.abs(e), 1e-3)
