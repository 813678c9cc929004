"""Gas that warms up while it flows into a chamber."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter, shape_parameter


class GasHeating(Flow):
    """Compression heats the gas in a chamber, and the wall of the chamber takes up the heat.

        dp/dt   = (1 + a) q - z/tau
        tau dz/dt = a tau q - z

    q is dp/dt of an isothermal chamber, and z the pressure by which the warm gas exceeds the
    pressure at the temperature of the wall. Without heat exchange, p changes by the factor 1 + a
    faster, where 1 + a is the ratio of the specific heats, 1.4 for air. A second volume behind a
    thin hose has the same law, with its volume divided by the first volume as a. Source: Beater, P.
    (2007), Pneumatic Drives, Springer, section on heat exchange of chambers.
    """

    title = "gas that warms up while a chamber fills"
    order = 182
    states = 1

    a: Scalar = parameter(0.0, 0.0, 0.4, "-", "the ratio of the specific heats of air is 1.4")
    """a, relative change of dp/dt before the gas exchanges heat."""
    tau: Scalar = shape_parameter(
        0.1, 0.01, 2.0, "s", "chambers of a soft robot hold some millilitres to some decilitres"
    )
    """tau, time constant of the heat exchange."""

    def rate(self, rate, x):
        return (1.0 + self.a) * rate - x.states[0] / self.tau

    def state_rates(self, rate, x):
        return (self.a * rate - x.states[0] / self.tau)[None]
