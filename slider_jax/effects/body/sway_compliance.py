"""A mounting that yields sideways."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Mounting, parameter


class SwayCompliance(Mounting):
    """The head moves along n against the carriage like a spring of stiffness 1/c.

        V_n - V_n,carriage = -c dN/dt,    N lagging as `MOUNT_LAG` says

    N at the head is what the mounting puts on the body; the spring carries -N, the recoil, and
    gives way along it. Source: Meirovitch, L. (2001), Fundamentals of Vibrations, McGraw-Hill,
    ch. 1.
    """

    title = "the mounting yields sideways"
    order = 380

    compliance: Scalar = parameter(
        0.0, 0.0, 1e-3, "m/N", "a thin strut, 1 kN/m, at most; a stiff stand has 1e-5", 1e-4
    )
    """c, the inverse of the mounting's stiffness [N/m]."""

    def give(self, rates):
        zero = jnp.zeros_like(rates.N_t)
        return zero, -self.compliance * rates.N_t, zero
