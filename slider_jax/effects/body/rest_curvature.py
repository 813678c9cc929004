"""A body with rest curvature."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class RestCurvature(BendingMoment):
    """Without pressure, the actuated body has the curvature m_0/EI.

        M = EI kappa - m_0

    A rollout from rest starts straight and then bends to this curvature.
    Source: Audoly, B. and Pomeau, Y. (2010), Elasticity and Geometry, Oxford, ch. 3.
    """

    title = "the body is bent at rest"
    order = 360

    m_0: Scalar = parameter(
        0.0, -0.03, 0.03, "N m", "walls that differ by 10 %, or bending by 0.8 1/m in storage"
    )
    """Moment that would straighten the body. A positive m_0 bends it like a positive pressure."""

    def moment(self, x, memory, dt):
        return -(1.0 - x.in_tail) * self.m_0, memory
