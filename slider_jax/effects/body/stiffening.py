"""A body that stiffens as it bends."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class Stiffening(BendingMoment):
    """Cubic elasticity of the actuated body, from strongly stretched rubber walls or folds.

        M = EI kappa + beta kappa^3

    It is the first odd term after the linear one. A negative beta softens; the body stays stable
    while 3 |beta| kappa^2 < EI. Source: Nayfeh, A. H. and Mook, D. T. (1979), Nonlinear
    Oscillations, Wiley, ch. 2.
    """

    title = "the body stiffens as it bends"
    order = 310

    beta: Scalar = parameter(
        0.0, -2e-4, 2e-3, "N m^4", "half of EI kappa at kappa = 3 1/m; softens by a twentieth"
    )
    """Coefficient of the cubic term."""

    def moment(self, x, memory, dt):
        return (1.0 - x.in_tail) * self.beta * x.kappa**3, memory
