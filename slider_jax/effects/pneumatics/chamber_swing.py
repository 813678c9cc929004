"""A bending mode of the body that changes the volume of the chambers."""

import math

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter, shape_parameter
from slider_jax.effects.pneumatics.chamber_expansion import ATMOSPHERE


class ChamberSwing(Flow):
    """The body swings, and the chamber on the outer side of the bend is larger.

        dp/dt     = q - c (p_a + |p|) dy/dt
        d^2y/dt^2 = w^2 (p - y) - 2 D w dy/dt,    w = 2 pi f

    q is dp/dt of a chamber with a constant volume, and p_a the atmospheric pressure. y describes
    the displacement of the body's first bending mode: it is the pressure that holds this
    displacement at rest. The volume grows by the fraction c y. Source: mass balance of a variable
    volume, Beater, P. (2007), Pneumatic Drives, Springer.
    """

    title = "swinging body that changes the volume of the chambers"
    order = 184
    states = 2

    c: Scalar = parameter(
        0.0, 0.0, 1e-6, "1/Pa", "the volume of a bent chamber grows by a quarter at 250 kPa"
    )
    """c, relative increase of the volume by the static displacement, per pressure."""
    frequency: Scalar = shape_parameter(
        2.5, 0.5, 20.0, "Hz", "soft bodies of 0.1 to 1 m", physical=(0.01, math.inf)
    )
    """f, natural frequency of the mode."""
    damping: Scalar = shape_parameter(
        0.1, 0.01, 2.0, "-", "from a body in air to a body in water", physical=(0.0, math.inf)
    )
    """D, damping ratio of the mode."""

    def start(self, p):
        return jnp.stack([p, jnp.zeros_like(p)])

    def rate(self, rate, x):
        return rate - self.c * (ATMOSPHERE + jnp.abs(x.p)) * x.states[1]

    def state_rates(self, rate, x):
        y, speed = x.states
        w = 2.0 * math.pi * self.frequency
        return jnp.stack([speed, w**2 * (x.p - y) - 2.0 * self.damping * w * speed])
