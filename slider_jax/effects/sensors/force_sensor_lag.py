"""Lag of the force sensor, from its amplifier or filter."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, last_sample, parameter
from slider_jax.effects.functions import lagged, lagged_sample


class ForceSensorLag(Instrument):
    """Thrust and recoil pass a first-order low-pass filter.

        tau dF_read/dt = F - F_read

    The solution is exact if the true force F is linear between samples. Source: first-order
    instruments, Doebelin, E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill, ch. 3.
    """

    title = "lag of the force sensor"
    order = 610
    sensors = ("thrust", "recoil")

    tau: Scalar = parameter(
        0.0, 0.0, 0.03, "s", "bridge amplifiers have low-pass filters of 5 Hz and higher"
    )
    """tau, time constant of the filter [s]."""

    def read(self, true):
        return true._replace(
            thrust=lagged(true.thrust, true.t, self.tau),
            recoil=lagged(true.recoil, true.t, self.tau),
        )

    def read_sample(self, true, read):
        return last_sample(true)._replace(
            thrust=lagged_sample(true.thrust, true.t, self.tau, read.thrust),
            recoil=lagged_sample(true.recoil, true.t, self.tau, read.recoil),
        )
