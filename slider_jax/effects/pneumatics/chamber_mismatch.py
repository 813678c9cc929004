"""A difference between front and rear chambers."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class ChamberMismatch(ActingPressure):
    """The front chamber has a larger K_Q than the rear chamber; the mean K_Q is unchanged.

        p_act = ((1 + d) p_front, (1 - d) p_rear)

    Source: K_Q is the product of a chamber's cross-section and lever arm, both made by hand;
    Polygerinos, P. et al. (2015), Modeling of soft fiber-reinforced bending actuators, IEEE Trans.
    Robot. 31, 778-789.
    """

    title = "front and rear chambers bend differently"
    order = 230

    difference: Scalar = parameter(
        0.0, -0.3, 0.3, "-", "hand-made chambers differ by tens of percent"
    )
    """d, half the difference of the two K_Q, divided by the mean K_Q."""

    def act(self, p, memory, dt):
        d = self.difference
        return jnp.stack([(1.0 + d) * p[0], (1.0 - d) * p[1]]), memory
