"""Filling and venting at different time constants."""

from slider_jax.effects.base import Flow, parameter
from slider_jax.effects.smooth import filling
from slider_jax.parameters import Scalar


class FillVentAsymmetry(Flow):
    """A chamber fills from the supply faster than it vents to the room, or slower.

        dp/dt = (1 + a s) (p_set - p)/k,    s = tanh(p/w) tanh((p_set - p)/w),    w = 20 kPa

    s is +1 while |p| grows, -1 while it falls, so filling takes k/(1 + a) and venting k/(1 - a).
    Source: charge and discharge of a volume, Beater, P. (2007), Pneumatic Drives, Springer.
    """

    title = "filling and venting take different times"
    sensors = ("pressure", "thrust", "recoil", "tip")

    asymmetry: Scalar = parameter(
        0.0, -0.5, 0.5, "-", "venting up to three times slower than filling, or faster"
    )
    """a, half the difference of the two rates over their mean."""

    def rate(self, rate, p, p_set, k):
        return (1.0 + self.asymmetry * filling(p, p_set)) * rate
