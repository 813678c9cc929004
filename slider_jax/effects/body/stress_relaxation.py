"""Stress that relaxes at constant curvature."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter, shape_parameter


class StressRelaxation(BendingMoment):
    """Standard linear solid: a spring E_1 and a dashpot in series, both parallel to the body's EI.

        M = EI kappa + E_1 q,    dq/dt = d(kappa)/dt - q/tau

    The state q is the curvature of the spring E_1, and tau is the relaxation time.
    Source: Christensen, R. M. (1982), Theory of Viscoelasticity, 2nd ed., Academic Press, ch. 1.
    """

    title = "stress relaxes"
    order = 340
    segments = ("body",)

    E_1: Scalar = parameter(
        0.0, 0.0, 0.02, "N m^2", "silicone and sleeves relax by 10 to 50 % of EI = 0.038 N m^2"
    )
    """Stiffness of the spring in series with the dashpot."""
    tau: Scalar = shape_parameter(
        0.1, 0.02, 2.0, "s", "half of a stride of 0.2 s; elastomers have times from ms to minutes"
    )
    """tau, relaxation time."""

    def moment(self, x, memory, dt):
        q = (memory + dt * x.kappa_t) / (1.0 + dt / self.tau)
        return (1.0 - x.in_tail) * self.E_1 * q, q
