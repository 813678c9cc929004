"""A fixture that is in the water and on the sensor."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.effects.base import Instrument, parameter
from slider_jax.parameters import Scalar


class FixtureDrag(Instrument):
    """Form drag of the head and of the strut that holds it, as they are towed.

        thrust_read = thrust - rho A |U_tow| U_tow / 2

    Source: Hoerner, S. F. (1965), Fluid-Dynamic Drag, ch. 3.
    """

    title = "the fixture's own drag"
    sensors = ("thrust",)

    area: Scalar = parameter(
        0.0, 0.0, 4e-3, "m^2", "a blunt head of 30 by 60 mm and a strut of 20 by 100 mm"
    )
    """A, drag coefficient times frontal area."""
    tow_speed: Scalar = eqx.field(default=0.1)
    """U_tow [m/s], of the trial."""
    density: Scalar = eqx.field(default=1000.0)
    """rho [kg/m^3]."""

    def read(self, true):
        drag = 0.5 * self.density * self.area * jnp.abs(self.tow_speed) * self.tow_speed
        return true._replace(thrust=true.thrust - drag)
