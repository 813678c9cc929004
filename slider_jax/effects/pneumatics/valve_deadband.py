"""Valves that stay closed at a small error."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter
from slider_jax.effects.functions import LIMIT_EXPONENT, magnitude


class ValveDeadband(Flow):
    """The valves stay closed at an error below d; at a larger error, the lag is unchanged.

        dp/dt = e/k exp(-(d/|e|)^32),    e = p_set - p

    The flow is half of the lag's flow at |e| = 1.01 d, and 1e-9 of the lag's flow at |e| = 0.91 d.
    So the pressure stops changing at a distance of about d from the set pressure. `ValveOverlap`
    also reduces the flow at larger errors. Source: on-off control of a pressure, Beater, P. (2007),
    Pneumatic Drives, Springer.
    """

    title = "deadband of the valves"
    order = 110

    band: Scalar = parameter(
        0.0, 0.0, 40e3, "Pa", "up to 1/8 of the largest set pressure; short pulses open no valve",
        12e3,
    )  # fmt: skip
    """d, the error below which the valves stay closed."""

    def rate(self, rate, x):
        share = jnp.minimum(self.band / magnitude(x.p_set - x.p, 1.0), 1.5)
        return jnp.exp(-(share**LIMIT_EXPONENT)) * rate
