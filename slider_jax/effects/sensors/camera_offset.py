"""Zero error of the camera."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class CameraOffset(Instrument):
    """The recorded tip positions are shifted by the constant y_0.

        tip_read = tip + y_0

    A camera that is rolled by an angle a shifts a tip at the distance L from the head by a L, to
    first order. A marker beside the midline shifts the tip too. Source: camera calibration,
    Hartley, R. and Zisserman, A. (2004), Multiple View Geometry in Computer Vision, 2nd ed.,
    Cambridge University Press, ch. 6.
    """

    title = "zero error of the camera, for example by roll"
    order = 960
    sensors = ("tip",)

    offset: Scalar = parameter(
        0.0, -0.01, 0.01, "m", "a roll of 1.5 degrees shifts a tip 0.37 m from the head by 10 mm"
    )
    """y_0, shift of the recorded positions."""

    def read(self, true):
        return true._replace(tip=true.tip + self.offset)
