"""An error of the camera's scale."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, parameter


class CameraScale(Instrument):
    """The assumed scale in metres per pixel is too large by the factor 1 + g.

        tip_read = (1 + g) tip

    Source: pinhole camera, Hartley, R. and Zisserman, A. (2004), Multiple View Geometry in Computer
    Vision, 2nd ed., Cambridge University Press, ch. 6.
    """

    title = "scale error of the camera"
    order = 650
    sensors = ("tip",)

    gain: Scalar = parameter(
        0.0, -0.1, 0.1, "-", "the ruler was at another depth, or the surface refracts the light"
    )
    """g, relative error of the scale."""

    def read(self, true):
        return true._replace(tip=(1.0 + self.gain) * true.tip)
