"""A leak that opens at high pressure."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter, shape_parameter


class ReliefLeak(Flow):
    """A seam, a push-in fitting or a relief valve leaks above an opening pressure p_r.

        dp/dt = (p_set - p)/k - q sign(p) max(|p| - p_r, 0)

    `Leakage` acts at every pressure. Source: relief valves, Andersen, B. W. (1967), The analysis
    and design of pneumatic systems, Wiley.
    """

    title = "a leak opens at high pressure"
    order = 680

    leak: Scalar = parameter(
        0.0, 0.0, 10.0, "1/s", "an open seam leaks as much as an open valve, 1/k = 11 1/s"
    )
    """q, rate of the leak per pressure above p_r."""
    opening: Scalar = shape_parameter(
        100e3, 10e3, 400e3, "Pa", "below the drive amplitude of 100 to 450 kPa"
    )
    """p_r, opening pressure."""

    def rate(self, rate, x):
        return rate - self.leak * jnp.sign(x.p) * jnp.maximum(jnp.abs(x.p) - self.opening, 0.0)
