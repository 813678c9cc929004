"""Valves that stay shut at a small error."""

import jax.numpy as jnp

from slider_jax.effects.base import Flow, parameter
from slider_jax.effects.smooth import magnitude
from slider_jax.parameters import Scalar


class ValveDeadband(Flow):
    """Next to no flow within a band around the set pressure, and short of it outside.

        dp/dt = exp(-d/|e|) e/k,    e = p_set - p

    Far outside the band exp(-d/|e|) e is e - d sign(e), the flow of a hard deadband; within a
    quarter of it less than 2 % are left. |e| is rounded below 500 Pa. d is not negative. Source:
    overlap of a valve's spool, Beater, P. (2007), Pneumatic Drives, Springer.
    """

    title = "deadband of the valves"
    sensors = ("pressure", "thrust", "recoil", "tip")

    band: Scalar = parameter(
        0.0, 0.0, 30e3, "Pa", "a tenth of the largest set pressure; a pulse too short opens nothing"
    )
    """d, half the width of the band."""

    def rate(self, rate, p, p_set, k):
        return jnp.exp(-self.band / magnitude(p_set - p, 500.0)) * rate
