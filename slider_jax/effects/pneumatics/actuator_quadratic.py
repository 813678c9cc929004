"""An actuator whose moment grows faster than its pressure."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class ActuatorQuadratic(ActingPressure):
    """The moment has a quadratic part, because the chambers' section and lever arm grow.

        p_act = p (1 + q |p|)

    To first order in q, this is `ActuatorSaturation` with the opposite sign. Source: Polygerinos,
    P. et al. (2015), Modeling of soft fiber-reinforced bending actuators, IEEE Trans. Robot. 31,
    778-789.
    """

    title = "the actuators' moment grows faster than the pressure"
    order = 210

    quadratic: Scalar = parameter(
        0.0, 0.0, 3e-6, "1/Pa", "at 330 kPa, the moment per pressure at most doubles"
    )
    """q, relative growth of the moment per pressure."""

    def act(self, p, memory, dt):
        return p * (1.0 + self.quadratic * jnp.abs(p)), memory
