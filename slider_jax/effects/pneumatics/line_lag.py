"""The tube between the sensor and the chamber."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter
from slider_jax.effects.functions import lag_coefficients


class LineLag(ActingPressure):
    """The chamber pressure y follows the sensor's pressure p with a first-order lag.

        tau dy/dt = p - y

    The pressure y bends the body. The solution is exact if p is linear within a step. Source:
    pressure transmission in tubes, Holman, J. P. (2012), Experimental Methods for Engineers, 8th
    ed., McGraw-Hill, ch. 6.
    """

    title = "lag of the line to the chamber"
    order = 190

    tau: Scalar = parameter(
        0.0, 0.0, 0.05, "s", "1 m of thin tube to a bladder has a time constant of 5 to 50 ms"
    )
    """tau, time constant of the tube."""

    def act(self, p, memory, dt):
        y, before = memory
        e, m = lag_coefficients(self.tau, dt)
        y = p + e * (y - before) - m * (p - before)
        return y, jnp.stack([y, p])
