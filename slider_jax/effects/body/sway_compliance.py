"""A mounting that yields laterally."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Mounting, parameter


class SwayCompliance(Mounting):
    """The head moves along n relative to the carriage, held by a spring of stiffness 1/c.

        V_n - V_n,carriage = -c dN/dt

    N is the force of the mounting on the head, filtered with the time constant 1 ms (`MOUNT_LAG`).
    The recoil -N acts on the spring, which yields in the direction of the recoil. Source:
    Meirovitch, L. (2001), Fundamentals of Vibrations, McGraw-Hill, ch. 1.
    """

    title = "the mounting yields laterally"
    order = 380

    compliance: Scalar = parameter(
        0.0, 0.0, 1e-3, "m/N", "1e-3 for a thin strut, 1e-5 for a stiff stand", 1e-4
    )
    """c, lateral displacement of the head per force."""

    def give(self, rates):
        zero = jnp.zeros_like(rates.N_t)
        return zero, -self.compliance * rates.N_t, zero
