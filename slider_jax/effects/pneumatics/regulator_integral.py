"""Integral part of the pressure regulator."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter


class RegulatorIntegral(Flow):
    """The controller of the regulator integrates its error, so the pressure overshoots.

        dp/dt = q + c z,    dz/dt = p_set - p,    z(0) = 0

    q is dp/dt without the effect. The pressure with the lag oscillates for c k^2 > 1/4. Source:
    proportional-integral control, Astrom, K. J. and Murray, R. M. (2008), Feedback Systems,
    Princeton, ch. 10.
    """

    title = "integral part of the pressure regulator"
    order = 188
    states = 1

    c: Scalar = parameter(0.0, 0.0, 150.0, "1/s^2", "with k = 0.08 s, 39 1/s^2 is critical damping")
    """c, integral gain of the regulator divided by its time constant."""

    def rate(self, rate, x):
        return rate + self.c * x.states[0]

    def state_rates(self, rate, x):
        return (x.p_set - x.p)[None]
