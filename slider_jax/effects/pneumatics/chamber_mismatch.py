"""A difference between the first and the last chamber."""

from slider_jax.actuation.waveform import rear_of
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class ChamberMismatch(ActingPressure):
    """The first and the last chamber have different K_Q. The mean K_Q is unchanged.

        p_act = (1 + d (1 - 2 r)) p

    r is 0 at the first and 1 at the last chamber, and evenly spaced between. K_Q is the moment per
    pressure: the cross-section of a chamber times the lever arm. Source: Polygerinos, P. et al.
    (2015), Modeling of soft fiber-reinforced bending actuators, IEEE Trans. Robot. 31, 778-789.
    """

    title = "first and last chamber bend differently"
    order = 230

    difference: Scalar = parameter(
        0.0, -0.3, 0.3, "-", "hand-made chambers differ by tens of percent"
    )
    """d, half of the difference of K_Q (first minus last), divided by the mean K_Q."""

    def act(self, p, memory, dt):
        return p * (1.0 + self.difference * (1.0 - 2.0 * rear_of(p.shape[-1]))), memory
