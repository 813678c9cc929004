"""Chambers that also bend each other's span."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class ChamberCrosstalk(ActingPressure):
    """Each chamber also bends the span of the other, through the common skin.

        p_act = (p_front + c p_rear, p_rear + c p_front)

    Source: linear cross-sensitivity, Doebelin, E. O. (2003), Measurement Systems, 5th ed.,
    McGraw-Hill, ch. 2.
    """

    title = "each chamber also bends the other's span"
    order = 240

    share: Scalar = parameter(
        0.0, -0.1, 0.3, "-", "spans share 1 cm of 13 and the skin; small values of either sign"
    )
    """c, share of a chamber's moment in the span of the other."""

    def act(self, p, memory, dt):
        return jnp.stack([p[0] + self.share * p[1], p[1] + self.share * p[0]]), memory
