"""Crosstalk between the front chamber and the rear chamber."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class ChamberCrosstalk(ActingPressure):
    """Each chamber also bends the part of the body around the other chamber.

        p_act = (p_front + c p_rear, p_rear + c p_front)

    The two chambers have a common skin. Source: linear cross-sensitivity, Doebelin, E. O. (2003),
    Measurement Systems, 5th ed., McGraw-Hill, ch. 2.
    """

    title = "each chamber also bends the other chamber's span"
    order = 240

    share: Scalar = parameter(
        0.0, -0.1, 0.3, "-", "the chambers are 1 cm apart and have a common skin"
    )
    """c, fraction of a chamber's moment that acts on the body around the other chamber."""

    def act(self, p, memory, dt):
        return jnp.stack([p[0] + self.share * p[1], p[1] + self.share * p[0]]), memory
