"""Weight, for climbing in air."""

from slider_jax.effects.base import ForceDensity
from slider_jax.frame import to_body
from slider_jax.parameters import Scalar


class Gravity(ForceDensity):
    """Weight per unit length, less buoyancy, along -x: a climbing body has its head up the x axis.

        (F_x, F_y) = (-m g, 0)

    Vanishes at g = 0. In water use the reduced g (1 - rho A/m); SLIDER is near neutral there.
    """

    g: Scalar = 9.81
    """Acceleration [m/s^2]."""

    def force(self, x):
        weight = x.linear_density * self.g
        return to_body((-weight, 0.0 * weight), x.phi)
