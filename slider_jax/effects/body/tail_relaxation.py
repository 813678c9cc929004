"""Stress relaxation of the tail."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter, shape_parameter


class TailRelaxation(BendingMoment):
    """Standard linear solid in the passive tail, with the law of `StressRelaxation`.

        M = EI kappa + E_1 q,    dq/dt = d(kappa)/dt - q/tau

    The state q is the curvature of the spring E_1. Source: Christensen, R. M. (1982), Theory of
    Viscoelasticity, 2nd ed., Academic Press, ch. 1.
    """

    title = "stress relaxes in the tail"
    order = 750
    segments = ("tail",)

    E_1: Scalar = parameter(
        0.0, 0.0, 0.005, "N m^2", "soft sheets relax by up to 80 % of EI_tail = 0.0058 N m^2"
    )
    """Stiffness of the spring in series with the dashpot."""
    tau: Scalar = shape_parameter(
        0.1, 0.02, 2.0, "s", "half of a stride of 0.2 s; elastomers have times from ms to minutes"
    )
    """tau, relaxation time."""

    def moment(self, x, memory, dt):
        q = (memory + dt * x.kappa_t) / (1.0 + dt / self.tau)
        return x.in_tail * self.E_1 * q, q
