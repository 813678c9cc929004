"""A force sensor that is not yet warm when a trial starts."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter, shape_parameter


class ForceWarmUp(Instrument):
    """The zeros of the force sensor approach their final values exponentially.

        thrust_read = thrust + a (1 - exp(-t/tau)),    recoil_read = recoil + b (1 - exp(-t/tau))

    t is the time since the start of the trial. The excitation of the strain gauges warms the
    sensor, or the water cools it. Source: thermal zero shift of strain gauges, Doebelin, E. O.
    (2003), Measurement Systems, 5th ed., McGraw-Hill, ch. 4.
    """

    title = "the force sensor warms up"
    order = 880
    sensors = ("thrust", "recoil")

    thrust: Scalar = parameter(
        0.0, -0.1, 0.1, "N", "a bridge of 50 N drifts by 10 mN/K, and warms by up to 10 K"
    )
    """a, final change of the thrust's zero."""
    recoil: Scalar = parameter(
        0.0, -0.1, 0.1, "N", "a bridge of 50 N drifts by 10 mN/K, and warms by up to 10 K"
    )
    """b, final change of the recoil's zero."""
    tau: Scalar = shape_parameter(
        0.5, 0.1, 20.0, "s", "foil gauges warm in a fraction of a second, a sensor body in 10 s"
    )
    """tau, time constant of the temperature."""

    def read(self, true):
        share = -jnp.expm1(-true.t / self.tau)
        return true._replace(
            thrust=true.thrust + self.thrust * share, recoil=true.recoil + self.recoil * share
        )
