"""A clamp that rotates under the bending moment."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Mounting, parameter


class ClampCompliance(Mounting):
    """The head rotates relative to the carriage, held by a spring of stiffness 1/c.

        phi_head - phi_carriage = -c M_head

    M_head is the moment of the clamp on the body, filtered with the time constant 1 ms
    (`MOUNT_LAG`). A positive M_head bends the body to positive curvature. Source: beam on an
    elastic support, Blevins, R. D. (1979), Formulas for natural frequency and mode shape, ch. 8.
    """

    title = "the clamp rotates under load"
    order = 370

    compliance: Scalar = parameter(
        0.0, 0.0, 3.0, "rad/(N m)", "0 for a rigid clamp; 3 is a third of the body's L/EI"
    )
    """c, rotation of the clamp per moment."""

    def give(self, rates):
        zero = jnp.zeros_like(rates.M_t)
        return zero, zero, -self.compliance * rates.M_t
