"""A mounting that yields lengthwise."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Mounting, parameter


class SurgeCompliance(Mounting):
    """The head moves along tau against the carriage like a spring of stiffness 1/c.

        V_tau - V_tau,carriage = -c dT/dt,    T lagging as `MOUNT_LAG` says

    T at the head is what the mounting puts on the body; the spring carries -T, the thrust, and
    gives way along it. Source: Meirovitch, L. (2001), Fundamentals of Vibrations, McGraw-Hill,
    ch. 1.
    """

    title = "the mounting yields lengthwise"
    order = 390

    compliance: Scalar = parameter(
        0.0,
        0.0,
        3e-4,
        "m/N",
        "a soft sensor or strut, 3 kN/m; softer, the robot would bounce",
        3e-5,
    )
    """c, the inverse of the mounting's stiffness [N/m]."""

    def give(self, rates):
        zero = jnp.zeros_like(rates.T_t)
        return -self.compliance * rates.T_t, zero, zero
