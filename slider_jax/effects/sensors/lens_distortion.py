"""Distortion of the camera's lens."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class LensDistortion(Instrument):
    """The magnification of the camera changes with the distance from the optical axis.

        tip_read = tip (1 + k tip^2)

    The optical axis is at the line through the straight robot. k is positive for a pincushion and
    negative for a barrel distortion. Source: radial distortion, Hartley, R. and Zisserman, A.
    (2004), Multiple View Geometry in Computer Vision, 2nd ed., Cambridge University Press, ch. 7.
    """

    title = "distortion of the camera's lens"
    order = 950
    sensors = ("tip",)

    k: Scalar = parameter(
        0.0, -20.0, 20.0, "1/m^2", "20 % at 0.1 m from the axis, for a wide-angle lens"
    )
    """k, relative change of the magnification per squared distance."""

    def read(self, true):
        return true._replace(tip=true.tip * (1.0 + self.k * true.tip**2))
