"""Damping of the tail."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class TailDamping(BendingMoment):
    """The material of the tail damps more than the material of the body.

        M = EI (kappa + (alpha + a) d(kappa)/dt)    in the tail

    alpha is the damping time of body and tail. Source: Kelvin-Voigt solid, Christensen, R. M.
    (1982), Theory of Viscoelasticity, 2nd ed., Academic Press, ch. 1.
    """

    title = "the tail damps more than the body"
    order = 780
    segments = ("tail",)

    a: Scalar = parameter(
        0.0, 0.0, 0.02, "s", "0.016 for a sheet with a loss factor of 0.5 at 5 Hz"
    )
    """a, additional damping time of the tail."""

    def moment(self, x, memory, dt):
        return x.in_tail * x.EI * self.a * x.kappa_t, memory
