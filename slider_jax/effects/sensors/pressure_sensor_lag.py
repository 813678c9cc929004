"""Pressure sensors that follow late."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter
from slider_jax.effects.sensors.series import lagged


class PressureSensorLag(Instrument):
    """Both pressures pass a first-order low-pass: the sensor's own tube, or a filter.

        tau dp_read/dt = p - p_read

    Exact for a pressure that is linear between samples. The body feels p, not p_read. Source:
    first-order instruments, Doebelin, E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill,
    ch. 3.
    """

    title = "lag of the pressure sensors"
    sensors = ("pressure",)

    tau: Scalar = parameter(
        0.0, 0.0, 0.05, "s", "thin tubes to the sensors and filters against noise: to tens of ms"
    )
    """Time constant [s]."""

    def read(self, true):
        return true._replace(
            p_front=lagged(true.p_front, true.t, self.tau),
            p_rear=lagged(true.p_rear, true.t, self.tau),
        )
