"""A body with rest curvature."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class RestCurvature(BendingMoment):
    """Without pressure, the actuated body has the curvature m_0/EI.

        M = EI kappa - m_0

    In a simulation from rest, the body starts straight and then bends to this curvature.
    Source: Audoly, B. and Pomeau, Y. (2010), Elasticity and Geometry, Oxford, ch. 3.
    """

    title = "the body is bent at rest"
    order = 360
    segments = ("body",)

    m_0: Scalar = parameter(
        0.0, -0.03, 0.03, "N m", "a rest curvature of 0.8 1/m, from storage or walls 10 % too thick"
    )
    """m_0, the moment that bends a straight body to its rest curvature. A positive m_0 bends the
    body in the same direction as a positive pressure."""

    def moment(self, x, memory, dt):
        return -(1.0 - x.in_tail) * self.m_0, memory
