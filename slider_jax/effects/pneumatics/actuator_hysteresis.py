"""Hysteresis of the actuators."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter, shape_parameter


class ActuatorHysteresis(ActingPressure):
    """Friction in the walls delays the moment relative to the pressure.

        p_act = p - A z,    w dz/dt = dp/dt - |dp/dt| z

    z is the state of the friction. While the pressure changes by a few w, z approaches the sign of
    dp/dt. With larger changes of pressure, the hysteresis loop is 2 A high. The loop does not
    depend on the rate of p. Each step is solved exactly. Source: Wen, Y.-K. (1976), Method for
    random vibration of hysteretic systems, J. Eng. Mech. Div. ASCE 102, 249-263, with exponent 1.
    """

    title = "hysteresis of the actuators"
    order = 250

    amplitude: Scalar = parameter(
        0.0, 0.0, 50e3, "Pa", "hysteresis of elastomer actuators is up to a third of the stroke"
    )
    """A, half the height of the hysteresis loop if the pressure changes by much more than w."""
    width: Scalar = shape_parameter(
        50e3, 5e3, 200e3, "Pa", "2 to 80 % of a drive amplitude of 250 kPa"
    )
    """w, the change of pressure that reverses z."""

    def act(self, p, memory, dt):
        # `held` is p - w z of the previous step. At the start, `held` is p, so z is zero.
        held, before = memory
        sign = jnp.sign(p - before)
        z = sign + ((before - held) / self.width - sign) * jnp.exp(
            -jnp.abs(p - before) / self.width
        )
        return p - self.amplitude * z, jnp.stack([p - self.width * z, p])
