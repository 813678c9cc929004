"""A difference between front and rear chambers."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class ChamberMismatch(ActingPressure):
    """The front and the rear chamber have different K_Q. The mean K_Q is unchanged.

        p_act = ((1 + d) p_front, (1 - d) p_rear)

    K_Q is the moment per pressure: the cross-section of a chamber times the lever arm. Source:
    Polygerinos, P. et al. (2015), Modeling of soft fiber-reinforced bending actuators, IEEE Trans.
    Robot. 31, 778-789.
    """

    title = "front and rear chambers bend differently"
    order = 230

    difference: Scalar = parameter(
        0.0, -0.3, 0.3, "-", "hand-made chambers differ by tens of percent"
    )
    """d, half of the difference of K_Q (front minus rear), divided by the mean K_Q."""

    def act(self, p, memory, dt):
        d = self.difference
        return jnp.stack([(1.0 + d) * p[0], (1.0 - d) * p[1]]), memory
