"""A material whose stress is not in proportion to its strain."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class CubicElasticity(BendingMoment):
    """Body and tail stiffen as they bend, in proportion to their own stiffness.

        M = EI kappa (1 + b kappa^2)

    `Stiffening` is of the actuated body alone. b below zero softens. Source: Nayfeh, A. H. and
    Mook, D. T. (1979), Nonlinear Oscillations, Wiley, ch. 2.
    """

    title = "body and tail stiffen as they bend"
    order = 320

    b: Scalar = parameter(
        0.0,
        -0.005,
        0.1,
        "m^2",
        "twice the stiffness where kappa = 3 1/m; softens by a tenth",
    )
    """Relative growth of the stiffness per square of the curvature."""

    def moment(self, x, memory, dt):
        return x.EI * self.b * x.kappa**3, memory
