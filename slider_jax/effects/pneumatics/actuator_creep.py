"""Creep of the actuators."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter, shape_parameter
from slider_jax.effects.functions import lag_coefficients


class ActuatorCreep(ActingPressure):
    """The walls creep under pressure, so a part of the moment follows the pressure slowly.

        p_act = p + c y,    tau dy/dt = p - y

    After a step of the pressure to p, p_act increases from p to (1 + c) p. The solution is exact if
    p is linear within a step. Source: creep of elastomers, Christensen, R. M. (1982), Theory of
    Viscoelasticity, 2nd ed., Academic Press, ch. 1.
    """

    title = "the actuators creep under pressure"
    order = 700

    share: Scalar = parameter(
        0.0, 0.0, 0.5, "-", "elastomer actuators bend 10 to 50 % further after a step of pressure"
    )
    """c, moment of the slow part divided by the moment of the fast part, at constant pressure."""
    tau: Scalar = shape_parameter(
        0.2, 0.03, 5.0, "s", "a stride of 0.2 s; elastomers have times from ms to minutes"
    )
    """tau, time constant of the creep."""

    def act(self, p, memory, dt):
        y, before = memory
        e, m = lag_coefficients(self.tau, dt)
        y = p + e * (y - before) - m * (p - before)
        return p + self.share * y, jnp.stack([y, p])
