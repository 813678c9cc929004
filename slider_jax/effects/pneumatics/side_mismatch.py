"""A difference between left and right chambers."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class SideMismatch(ActingPressure):
    """The left chambers (p > 0) and the right chambers (p < 0) have different K_Q.

        p_act = p + d |p|

    K_Q is the moment per pressure: the cross-section of a chamber times the lever arm. The mean K_Q
    of the two sides is unchanged. Source: Polygerinos, P. et al. (2015), Modeling of soft
    fiber-reinforced bending actuators, IEEE Trans. Robot. 31, 778-789.
    """

    title = "left and right chambers bend differently"
    order = 690

    difference: Scalar = parameter(
        0.0, -0.3, 0.3, "-", "hand-made chambers differ by tens of percent"
    )
    """d, half of the difference of K_Q (left minus right), divided by the mean K_Q."""

    def act(self, p, memory, dt):
        return p + self.difference * jnp.abs(p), memory
