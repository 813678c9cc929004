"""Stress that relaxes at constant curvature."""

import equinox as eqx

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class StressRelaxation(BendingMoment):
    """Standard linear solid: a spring E_1 and a dashpot in series, both parallel to the body's EI.

        M = EI kappa + E_1 q,    dq/dt = d(kappa)/dt - q/tau

    The state q is the curvature of the spring E_1, and tau is the relaxation time.
    Source: Christensen, R. M. (1982), Theory of Viscoelasticity, 2nd ed., Academic Press, ch. 1.
    """

    title = "stress relaxes"
    order = 340

    E_1: Scalar = parameter(
        0.0, 0.0, 0.02, "N m^2", "silicone and sleeves relax by 10 to 50 % of EI = 0.038 N m^2"
    )
    """Stiffness of the spring in series with the dashpot."""
    tau: Scalar = eqx.field(default=0.1)
    """tau, relaxation time [s]. The default is half of a stride of 0.2 s."""

    def moment(self, x, memory, dt):
        q = (memory + dt * x.kappa_t) / (1.0 + dt / self.tau)
        return (1.0 - x.in_tail) * self.E_1 * q, q
