"""Delay of the camera."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter
from slider_jax.effects.functions import delayed


class CameraDelay(Instrument):
    """The recorded positions of the tail's tip have time stamps that are too late.

        tip_read(t) = tip(t - delay)

    Positions between samples are interpolated with cubic polynomials. Source: dead-time elements,
    Doebelin, E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill, ch. 3.
    """

    title = "dead time of the camera"
    order = 640
    sensors = ("tip",)

    delay: Scalar = parameter(
        0.0, 0.0, 0.1, "s", "exposure and transfer take up to a few frames at 30 to 60 Hz"
    )
    """delay [s], recorded time minus true time of a position."""

    def read(self, true):
        return true._replace(tip=delayed(true.tip, true.t, self.delay))
