"""A flow that does not grow in proportion to the pressure difference."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter
from slider_jax.effects.functions import magnitude


class FlowExponent(Flow):
    """Turbulent flow through the valve grows as a power of the pressure difference below 1.

        dp/dt = (|e|/p_ref)^(-b) e/k,    e = p_set - p,    p_ref = 100 kPa

    b = 0 is laminar, b = 1/2 an orifice in incompressible flow, for which e goes to zero in finite
    time. |e| is rounded below 5 kPa. Source: Bernoulli, e.g. White, F. M. (2011), Fluid Mechanics,
    7th ed., McGraw-Hill, sec. 6.12.
    """

    title = "flow grows less than the pressure difference"
    order = 140
    sensors = ("pressure", "thrust", "recoil", "tip")

    exponent: Scalar = parameter(0.0, 0.0, 0.5, "-", "laminar to turbulent")
    """b, what the power of the pressure difference lacks to 1."""

    def rate(self, rate, x):
        return (magnitude(x.p_set - x.p, 5e3) / 100e3) ** (-self.exponent) * rate
