"""A body that stiffens as it bends."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class Stiffening(BendingMoment):
    """Cubic elasticity of the actuated body, caused by strongly stretched rubber walls or folds.

        M = EI kappa + beta kappa^3

    The body is symmetric, so M has no quadratic term. With a negative beta, the stiffness decreases
    with curvature and is positive for 3 |beta| kappa^2 < EI. Source: Nayfeh, A. H. and Mook, D. T.
    (1979), Nonlinear Oscillations, Wiley, ch. 2.
    """

    title = "the body stiffens as it bends"
    order = 310
    segments = ("body",)

    beta: Scalar = parameter(
        0.0, -2e-4, 2e-3, "N m^4", "at kappa = 3 1/m, the moment is 5 % smaller to 50 % larger"
    )
    """beta, coefficient of the cubic term."""

    def moment(self, x, memory, dt):
        return (1.0 - x.in_tail) * self.beta * x.kappa**3, memory
