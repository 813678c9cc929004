"""A flow that is a power of the pressure difference."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter
from slider_jax.effects.functions import magnitude


class FlowExponent(Flow):
    """Turbulent flow through the valve is a power below 1 of the pressure difference.

        dp/dt = (|e|/p_ref)^(-b) e/k,    e = p_set - p,    p_ref = 100 kPa

    b = 0 is laminar flow. b = 1/2 is incompressible flow through an orifice, for which e reaches
    zero in finite time. |e| is rounded below 5 kPa. Source: Bernoulli, e.g. White, F. M. (2011),
    Fluid Mechanics, 7th ed., McGraw-Hill, sec. 6.12.
    """

    title = "flow grows more slowly than the pressure difference"
    order = 140

    exponent: Scalar = parameter(0.0, 0.0, 0.5, "-", "laminar to turbulent")
    """b; the flow is the power 1 - b of the pressure difference."""

    def rate(self, rate, x):
        return (magnitude(x.p_set - x.p, 5e3) / 100e3) ** (-self.exponent) * rate
