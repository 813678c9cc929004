"""Valves that stay shut at a small error."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter
from slider_jax.effects.functions import SHARP, magnitude


class ValveDeadband(Flow):
    """No flow while the error is within a band, the lag's flow outside.

        dp/dt = e/k exp(-(d/|e|)^32),    e = p_set - p

    Half of the flow is left at |e| = 1.01 d, one part in a billion at 0.9 d: the pressure stops
    short of its set point by the band. `ValveOverlap` lacks d of the flow outside too. Source:
    on-off control of a pressure, Beater, P. (2007), Pneumatic Drives, Springer.
    """

    title = "deadband of the valves"
    order = 110
    sensors = ("pressure", "thrust", "recoil", "tip")

    band: Scalar = parameter(
        0.0, 0.0, 40e3, "Pa", "an eighth of the largest set pressure; shorter pulses open nothing",
        12e3,
    )  # fmt: skip
    """d, half the width of the band."""

    def rate(self, rate, x):
        share = jnp.minimum(self.band / magnitude(x.p_set - x.p, 1.0), 1.5)
        return jnp.exp(-(share**SHARP)) * rate
