"""An actuator whose moment grows more slowly than its pressure."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class ActuatorSaturation(ActingPressure):
    """The moment saturates with the pressure.

        p_act = p/(1 + c |p|)

    At p = 1/c, half of the moment is lost. The walls of the actuators carry a part of the load, and
    this part increases with pressure. Source: Polygerinos, P. et al. (2015), Modeling of soft
    fiber-reinforced bending actuators, IEEE Trans. Robot. 31, 778-789.
    """

    title = "the actuators' moment saturates"
    order = 200

    inverse: Scalar = parameter(0.0, 0.0, 3e-6, "1/Pa", "half of the moment is lost at 330 kPa")
    """c, inverse of the pressure at which half of the moment is lost."""

    def act(self, p, memory, dt):
        return p / (1.0 + self.inverse * jnp.abs(p)), memory
