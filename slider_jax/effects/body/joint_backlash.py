"""Backlash of the joint between body and tail."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter, shape_parameter


class JointBacklash(BendingMoment):
    """The adapter between body and tail rotates freely by an angle g to either side.

        M = EI (kappa - a kappa/(kappa^2 + (w + a)^2)^(1/2)),    a = g delta(s - s_joint)

    In the two cells at the joint, the curvature a of the free rotation causes no moment. If
    |kappa| is much larger than w + a, the rotation is complete. Then the law is linear again.
    Source: backlash as a dead zone, Nordin, M. and Gutman, P.-O. (2002), Controlling mechanical
    systems with backlash - a survey, Automatica 38, 1633-1649.
    """

    title = "the joint of the tail has backlash"
    order = 790
    segments = ("body", "tail")

    play: Scalar = parameter(
        0.0, 0.0, 0.05, "rad", "a clamp or a printed adapter has 0.5 mm of play over 10 mm"
    )
    """g, free rotation to either side."""
    width: Scalar = shape_parameter(
        1.0, 0.1, 10.0, "1/m", "3 % to three times the curvature in a typical stride"
    )
    """w, curvature at which the adapter touches its stop; a soft stop has a large w."""

    def moment(self, x, memory, dt):
        a = self.play * x.joint
        return -x.EI * a * x.kappa / jnp.sqrt(x.kappa**2 + (self.width + a) ** 2), memory
