"""A tail with rest curvature."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class TailRestCurvature(BendingMoment):
    """Without load, the passive tail has the curvature kappa_0.

        M = EI (kappa - kappa_0)

    In a simulation from rest, the tail starts straight and then bends to this curvature.
    `RestCurvature` bends the actuated body. Source: Audoly, B. and Pomeau, Y. (2010), Elasticity
    and Geometry, Oxford, ch. 3.
    """

    title = "the tail is bent at rest"
    order = 770
    segments = ("tail",)

    kappa_0: Scalar = parameter(0.0, -3.0, 3.0, "1/m", "a sheet stored in a roll of 0.7 m diameter")
    """kappa_0, rest curvature of the tail."""

    def moment(self, x, memory, dt):
        return -x.in_tail * x.EI * self.kappa_0, memory
