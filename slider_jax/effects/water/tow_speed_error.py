"""An error of the declared speed of the gantry."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import WaterMotion, parameter


class TowSpeedError(WaterMotion):
    """The carriage moves faster than declared. The error is modelled as a water flow along -x.

        U_x = -g U_tow

    Source: static sensitivity, Doebelin, E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill,
    ch. 3.
    """

    title = "the carriage's speed has an error"
    order = 520

    gain: Scalar = parameter(
        0.0, -0.2, 0.2, "-", "lost motor steps or a wrong wheel diameter cause up to 20 %"
    )
    """g, relative error of the tow speed."""
    tow_speed: Scalar = eqx.field(default=0.1)
    """Tow speed U_tow [m/s] of the trial."""

    def velocity(self, t):
        zero = jnp.zeros_like(t)
        return zero - self.gain * self.tow_speed, zero
