"""Rubber that its first large strains soften."""

import jax
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter, shape_parameter


class MullinsSoftening(BendingMoment):
    """Rubber is softer below its largest previous strain than at the first loading.

        M = EI kappa (1 - c erf((q - kappa^2)/kappa_m^2)),    q = max kappa^2 since the start

    The trial begins with recovered rubber. At the first loading, q is kappa^2 and M is EI kappa.
    Source: Ogden, R. W. and Roxburgh, D. G. (1999), A pseudo-elastic model for the Mullins effect
    in filled rubber, Proc. R. Soc. A 455, 2861-2877, for an energy proportional to kappa^2.
    """

    title = "rubber that the first strokes soften"
    order = 970
    segments = ("body",)

    c: Scalar = parameter(
        0.0, 0.0, 0.8, "-", "filled rubbers lose up to 80 % of their stress", physical=(0.0, 1.0)
    )
    """c, largest relative loss of the moment."""
    kappa_m: Scalar = shape_parameter(
        2.0, 1.0, 10.0, "1/m", "a third to three times the curvature in a typical stride, 3 1/m"
    )
    """kappa_m, curvature scale of the softening."""

    def moment(self, x, memory, dt):
        square = x.kappa**2
        # The extrapolated memory of a stage may exceed the largest square slightly; the next step
        # begins from the value at the end of this step, so the excess does not accumulate.
        q = jnp.maximum(memory, square)
        lost = self.c * jax.lax.erf((q - square) / self.kappa_m**2)
        return -(1.0 - x.in_tail) * x.EI * x.kappa * lost, q
