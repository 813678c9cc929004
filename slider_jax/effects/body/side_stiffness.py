"""A body whose stiffness differs between bending to the left and to the right."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter
from slider_jax.effects.functions import magnitude

CURVATURE_ROUNDING = 0.1
"""w [1/m], width of the smoothing of |kappa|: 3 % of the curvature in a typical stride."""


class SideStiffness(BendingMoment):
    """The actuated body is stiffer for bending to one side than for bending to the other side.

        M = EI (kappa + d |kappa|)

    EI is the mean of both sides. |kappa| is smoothed to (kappa^2 + w^2)^(1/2) - w. `RestCurvature`
    has the same direction at every curvature. Source: bimodular materials, Jones, R. M. (1977),
    Stress-strain relations for materials with different moduli in tension and compression, AIAA J.
    15, 16-23.
    """

    title = "the body is stiffer when it bends to one side"
    order = 730
    segments = ("body",)

    difference: Scalar = parameter(
        0.0, -0.3, 0.3, "-", "a hose on one side and walls of unequal thickness"
    )
    """d, half of the difference of EI (positive minus negative curvature), divided by the mean."""

    def moment(self, x, memory, dt):
        size = magnitude(x.kappa, CURVATURE_ROUNDING) - CURVATURE_ROUNDING
        return (1.0 - x.in_tail) * self.difference * x.EI * size, memory
