"""A flow that is a power of the pressure difference."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter
from slider_jax.effects.functions import magnitude


class FlowExponent(Flow):
    """The flow through the valve is a power of the pressure difference, with the exponent 1 - b.

        dp/dt = (|e|/p_ref)^(-b) e/k,    e = p_set - p,    p_ref = 100 kPa

    b = 0 is laminar flow. b = 1/2 is incompressible flow through an orifice, for which e reaches
    zero in finite time. |e| is smoothed to sqrt(e^2 + (5 kPa)^2). Source: Bernoulli's equation,
    White, F. M. (2011), Fluid Mechanics, 7th ed., McGraw-Hill, sec. 6.12.
    """

    title = "flow grows more slowly than the pressure difference"
    order = 140

    exponent: Scalar = parameter(
        0.0, 0.0, 0.5, "-", "0 for laminar flow, 0.5 for an orifice", physical=(0.0, 0.9)
    )
    """b. The flow is proportional to |e|^(1 - b)."""

    def rate(self, rate, x):
        return (magnitude(x.p_set - x.p, 5e3) / 100e3) ** (-self.exponent) * rate
