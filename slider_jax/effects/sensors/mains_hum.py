"""Hum of the mains in the force readings."""

import math

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter, shape_parameter


class MainsHum(Instrument):
    """The mains couples a sine of constant frequency f into both force readings.

        F_read = F + a sin(2 pi f t) + b cos(2 pi f t)

    t is the time since the start of the trial. All trials have the same a and b, so the effect
    explains hum in several trials only if they start at the same phase of the mains. Source:
    interference, Horowitz, P. and Hill, W. (2015), The Art of Electronics, 3rd ed., Cambridge
    University Press, ch. 8.
    """

    title = "hum of the mains in the forces"
    order = 920
    sensors = ("thrust", "recoil")

    a: Scalar = parameter(0.0, -0.05, 0.05, "N", "0.1 % of full scale of a bridge of 50 N")
    """a, amplitude of the sine."""
    b: Scalar = parameter(0.0, -0.05, 0.05, "N", "0.1 % of full scale of a bridge of 50 N")
    """b, amplitude of the cosine."""
    frequency: Scalar = shape_parameter(
        50.0, 15.0, 125.0, "Hz", "mains of 16.7, 50 or 60 Hz, and twice 60 Hz"
    )
    """f, frequency."""

    def read(self, true):
        angle = 2.0 * math.pi * self.frequency * true.t
        hum = self.a * jnp.sin(angle) + self.b * jnp.cos(angle)
        return true._replace(thrust=true.thrust + hum, recoil=true.recoil + hum)
