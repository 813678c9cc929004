"""A mounting that yields axially."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Mounting, parameter


class SurgeCompliance(Mounting):
    """The head moves along tau relative to the carriage, held by a spring of stiffness 1/c.

        V_tau - V_tau,carriage = -c dT/dt

    T is the force of the mounting on the head, filtered with the time constant 1 ms (`MOUNT_LAG`).
    The thrust -T acts on the spring, which yields in the direction of the thrust. Source:
    Meirovitch, L. (2001), Fundamentals of Vibrations, McGraw-Hill, ch. 1.
    """

    title = "the mounting yields axially"
    order = 390

    compliance: Scalar = parameter(
        0.0,
        0.0,
        3e-4,
        "m/N",
        "a soft sensor or strut has 1/c = 3 kN/m; a robot on a softer mounting bounces",
        3e-5,
    )
    """c, axial displacement of the head per force."""

    def give(self, rates):
        zero = jnp.zeros_like(rates.T_t)
        return -self.compliance * rates.T_t, zero, zero
