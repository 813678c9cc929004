"""Terms of the motion of the water."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Curve, WaterMotion, parameter, shape_parameter
from slider_jax.effects.functions import WHY_FREQUENCY, RigDrift, Sine

DRIFT = 0.05
"""Velocity [m/s] that one unit of a drift's parameters adds."""
WHY = "the water moves more slowly than the tail"


class WaterSine(Sine, WaterMotion):
    """A component of the water's velocity is a sin(2 pi f t) + b cos(2 pi f t)."""

    a: Scalar = parameter(0.0, -0.5, 0.5, "m/s", WHY)
    """a, amplitude of the sine."""
    b: Scalar = parameter(0.0, -0.5, 0.5, "m/s", WHY)
    """b, amplitude of the cosine."""
    frequency: Scalar = shape_parameter(2.0, 0.1, 500.0, "Hz", WHY_FREQUENCY)
    """f, frequency of the most significant sine in the residual."""


class WaterSineAlong(WaterSine):
    """The water oscillates along x, the axis of the tank."""

    title = "water that oscillates along the tank"
    term_curve = Curve("phase, the fraction of f t", "-", "velocity U_x", "m/s")

    def velocity(self, t):
        return self.at(t), jnp.zeros_like(t)


class WaterSineAcross(WaterSine):
    """The water oscillates along y, across the tank."""

    title = "water that oscillates across the tank"
    term_curve = Curve("phase, the fraction of f t", "-", "velocity U_y", "m/s")

    def velocity(self, t):
        return jnp.zeros_like(t), self.at(t)


class WaterDrift(RigDrift, WaterMotion):
    """A component of the water's velocity is 0.05 m/s times a function of the time."""

    def basis(self, z):
        steady, slow, fast = super().basis(z)
        return DRIFT * steady, DRIFT * slow, DRIFT * fast


class WaterDriftAlong(WaterDrift):
    """The velocity of the water along x, the axis of the tank, drifts."""

    title = "current along the tank that drifts during a trial"
    term_curve = Curve("time t", "s", "velocity U_x", "m/s")

    def velocity(self, t):
        return self.at(t), jnp.zeros_like(t)


class WaterDriftAcross(WaterDrift):
    """The velocity of the water along y, across the tank, drifts."""

    title = "current across the tank that drifts during a trial"
    term_curve = Curve("time t", "s", "velocity U_y", "m/s")

    def velocity(self, t):
        return jnp.zeros_like(t), self.at(t)
