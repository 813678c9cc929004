"""Hoses that bypass the force sensor."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class HoseLoad(Instrument):
    """Pressurised hoses straighten and push on the force sensor.

        thrust_read = thrust + a (p_front + p_rear),    recoil_read = recoil + b (p_front + p_rear)

    Source: Bourdon's tube, Doebelin, E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill,
    ch. 6.
    """

    title = "the hoses push on the force sensor"
    order = 590
    sensors = ("thrust", "recoil")

    along: Scalar = parameter(
        0.0, -4e-7, 4e-7, "N/Pa", "a well guided soft hose of 4 mm exerts 0.1 N at 250 kPa"
    )
    """Coefficient a of the thrust."""
    across: Scalar = parameter(
        0.0, -4e-7, 4e-7, "N/Pa", "a well guided soft hose of 4 mm exerts 0.1 N at 250 kPa"
    )
    """Coefficient b of the recoil."""

    def read(self, true):
        p = true.p_front + true.p_rear
        return true._replace(
            thrust=true.thrust + self.along * p, recoil=true.recoil + self.across * p
        )
