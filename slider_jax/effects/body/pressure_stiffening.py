"""A body that stiffens under pressure."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class PressureStiffening(BendingMoment):
    """Pressure in a chamber increases the bending stiffness around this chamber.

        M = EI kappa + c |p| kappa

    p is the pressure of the chamber at the position s. Source: Comer, R. L. and Levy, S. (1963),
    Deflections of an inflated circular-cylindrical cantilever beam, AIAA J. 1, 1652-1655.
    """

    title = "pressure stiffens the body"
    order = 330
    segments = ("body",)

    c: Scalar = parameter(
        0.0, -5e-8, 2e-7, "N m^2/Pa", "at 250 kPa, the stiffness is 0.7 to 2.3 times EI"
    )
    """c, additional stiffness per pressure."""

    def moment(self, x, memory, dt):
        return self.c * jnp.abs(x.pressure) * x.kappa, memory
