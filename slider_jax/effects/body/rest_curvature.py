"""A body that is bent at rest."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class RestCurvature(BendingMoment):
    """The actuated body, without pressure, has the curvature m_0/EI.

        M = EI kappa - m_0

    A rollout from rest starts straight and springs to it.
    Source: Audoly, B. and Pomeau, Y. (2010), Elasticity and Geometry, Oxford, ch. 3.
    """

    title = "the body is bent at rest"
    order = 360

    m_0: Scalar = parameter(
        0.0, -0.03, 0.03, "N m", "walls unequal by a tenth, or a set of 0.8 1/m from storage"
    )
    """Moment that would straighten it; positive bends like positive pressure."""

    def moment(self, x, memory, dt):
        return -(1.0 - x.in_tail) * self.m_0, memory
