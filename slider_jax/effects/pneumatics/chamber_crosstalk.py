"""Crosstalk between the chambers."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, mean_of_others, parameter


class ChamberCrosstalk(ActingPressure):
    """Each chamber also bends the parts of the body around the other chambers.

        p_act = p + c p_other

    p_other is the mean pressure of the other chambers. The chambers have a common skin. Source:
    linear cross-sensitivity, Doebelin, E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill,
    ch. 2.
    """

    title = "each chamber also bends the other chambers' spans"
    order = 240

    share: Scalar = parameter(
        0.0, -0.1, 0.3, "-", "the chambers are 1 cm apart and have a common skin"
    )
    """c, fraction of a chamber's moment that acts on the body around the other chambers."""

    def act(self, p, memory, dt):
        return p + self.share * mean_of_others(p), memory
