"""Hysteresis of the actuators."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class ActuatorHysteresis(ActingPressure):
    """Friction in the walls delays the moment while pressure rises and while it falls.

        p_act = p - A z,    w dz/dt = dp/dt - |dp/dt| z

    While the pressure changes by a few w, z approaches the sign of dp/dt, so a wide loop is 2 A
    high. The loop does not depend on the rate of p. The step is exact: z_1 = s + (z_0 - s)
    exp(-|dp|/w), where s is the sign of dp. Source: Wen, Y.-K. (1976), Method for random vibration
    of hysteretic systems, J. Eng. Mech. Div. ASCE 102, 249-263, with exponent 1 and one slope.
    """

    title = "hysteresis of the actuators"
    order = 250

    amplitude: Scalar = parameter(
        0.0, 0.0, 50e3, "Pa", "hysteresis of elastomer actuators is up to a third of the stroke"
    )
    """A, half the height of a wide loop."""
    width: Scalar = eqx.field(default=50e3)
    """w [Pa], the change of pressure that reverses z."""

    def act(self, p, memory, dt):
        # The memory is p - w z. At the start, the memory is p, so z is zero.
        held, before = memory
        sign = jnp.sign(p - before)
        z = sign + ((before - held) / self.width - sign) * jnp.exp(
            -jnp.abs(p - before) / self.width
        )
        return p - self.amplitude * z, jnp.stack([p - self.width * z, p])
