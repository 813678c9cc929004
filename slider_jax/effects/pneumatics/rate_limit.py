"""A flow that the smallest passage limits."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter
from slider_jax.effects.functions import limited


class RateLimit(Flow):
    """The lag as long as it asks for less than the largest flow, and that flow otherwise.

        dp/dt = min(max((p_set - p)/k, -R), R)

    Its corners are rounded by `limited`. `ChokedFlow` falls short of the lag from the beginning;
    this one not before its limit. Source: saturation of a valve, Beater, P. (2007), Pneumatic
    Drives, Springer.
    """

    title = "the flow has a hard limit"
    order = 100
    sensors = ("pressure", "thrust", "recoil", "tip")

    inverse: Scalar = parameter(
        0.0, 0.0, 2e-6, "s/Pa", "reversing 250 kPa at k = 87 ms asks for 6 MPa/s; down to 0.5", 4e-7
    )
    """1/R, the inverse of the largest rate."""

    def rate(self, rate, x):
        return limited(rate, self.inverse)
