"""A current that builds up during a trial."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import WaterMotion, parameter, shape_parameter


class CurrentBuildup(WaterMotion):
    """The robot's own jet circulates in the tank and drives a current that grows with the time t.

        U_x = U (1 - exp(-t/tau))

    t is the time since the start of the trial. `TankCurrent` is constant. Source: momentum of a
    jet, Batchelor, G. K. (1967), An Introduction to Fluid Dynamics, Cambridge, ch. 5.
    """

    title = "a current builds up during the trial"
    order = 860

    U: Scalar = parameter(
        0.0, -0.2, 0.2, "m/s", "a jet of 0.2 m/s from the robot recirculates in a small tank"
    )
    """U, final velocity along x."""
    tau: Scalar = shape_parameter(
        2.0, 0.2, 30.0, "s", "a jet of 0.2 m/s needs seconds to circulate in a tank 1 m long"
    )
    """tau, time constant of the growth."""

    def velocity(self, t):
        U_x = -self.U * jnp.expm1(-t / self.tau)
        return U_x, jnp.zeros_like(U_x)
