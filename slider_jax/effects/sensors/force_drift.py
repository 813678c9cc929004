"""Drift of the force sensor."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class ForceDrift(Instrument):
    """The zeros of the force sensor drift linearly with the time t since the start of the trial.

        thrust_read = thrust + a t,    recoil_read = recoil + b t

    Source: zero drift of a measuring system, Doebelin, E. O. (2003), Measurement Systems, 5th ed.,
    McGraw-Hill, ch. 3.
    """

    title = "drift of the force sensor"
    order = 870
    sensors = ("thrust", "recoil")

    thrust: Scalar = parameter(
        0.0, -0.02, 0.02, "N/s", "a bridge of 50 N drifts by 10 mN/K; water cools it by up to 2 K/s"
    )
    """a, drift of the thrust."""
    recoil: Scalar = parameter(
        0.0, -0.02, 0.02, "N/s", "a bridge of 50 N drifts by 10 mN/K; water cools it by up to 2 K/s"
    )
    """b, drift of the recoil."""

    def read(self, true):
        return true._replace(
            thrust=true.thrust + self.thrust * true.t, recoil=true.recoil + self.recoil * true.t
        )
