"""A force sensor whose gain depends on the sign of the force."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class ForceSideGain(Instrument):
    """The gain of thrust and recoil differs between positive and negative forces.

        thrust_read = thrust + g |thrust|,    recoil_read = recoil + g |recoil|

    Source: tension and compression calibration of load cells, ASTM E74 (2018), Standard practices
    for calibration and verification for force-measuring instruments.
    """

    title = "the force sensor's gain depends on the sign"
    order = 890
    sensors = ("thrust", "recoil")

    difference: Scalar = parameter(
        0.0, -0.1, 0.1, "-", "below 0.01 for load cells; a loose or one-sided mount has 0.1"
    )
    """g, half of the difference of the gains (positive minus negative forces)."""

    def read(self, true):
        g = self.difference
        return true._replace(
            thrust=true.thrust + g * jnp.abs(true.thrust),
            recoil=true.recoil + g * jnp.abs(true.recoil),
        )
