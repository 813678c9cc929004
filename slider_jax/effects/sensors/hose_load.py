"""Hoses that push on the force sensor."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class HoseLoad(Instrument):
    """Hoses under pressure straighten and push on the force sensor.

        thrust_read = thrust + a p,    recoil_read = recoil + b p

    p is the sum of the pressures. Source: Bourdon's tube, Doebelin, E. O. (2003), Measurement
    Systems, 5th ed., McGraw-Hill, ch. 6.
    """

    title = "the hoses push on the force sensor"
    order = 590
    sensors = ("thrust", "recoil")

    along: Scalar = parameter(
        0.0, -4e-7, 4e-7, "N/Pa", "a soft hose of 4 mm with good guides exerts 0.1 N at 250 kPa"
    )
    """a, additional thrust per pressure."""
    across: Scalar = parameter(
        0.0, -4e-7, 4e-7, "N/Pa", "a soft hose of 4 mm with good guides exerts 0.1 N at 250 kPa"
    )
    """b, additional recoil per pressure."""

    def read(self, true):
        p = jnp.sum(true.pressures, axis=0)
        return true._replace(
            thrust=true.thrust + self.along * p, recoil=true.recoil + self.across * p
        )
