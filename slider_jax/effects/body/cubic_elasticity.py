"""A material with nonlinear elasticity."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class CubicElasticity(BendingMoment):
    """The bending stiffness increases with curvature, by the same fraction in body and tail.

        M = EI kappa (1 + b kappa^2)

    With a negative b, the stiffness decreases. `Stiffening` acts only on the actuated body. Source:
    Nayfeh, A. H. and Mook, D. T. (1979), Nonlinear Oscillations, Wiley, ch. 2.
    """

    title = "body and tail stiffen as they bend"
    order = 320
    segments = ("body", "tail")

    b: Scalar = parameter(
        0.0, -0.005, 0.1, "m^2", "at kappa = 3 1/m, the moment is 5 % smaller to 90 % larger"
    )
    """b, relative increase of the stiffness per squared curvature."""

    def moment(self, x, memory, dt):
        return x.EI * self.b * x.kappa**3, memory
