"""An actuator whose moment grows faster than its pressure."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class ActuatorQuadratic(ActingPressure):
    """The moment of a chamber has a part that is quadratic in the pressure p.

        p_act = p (1 + q |p|)

    Pressure enlarges the cross-section and the lever arm of a chamber. To first order in q, the
    effect equals `ActuatorSaturation` with the opposite sign. Source: Polygerinos, P. et al.
    (2015), Modeling of soft fiber-reinforced bending actuators, IEEE Trans. Robot. 31, 778-789.
    """

    title = "the actuators' moment grows faster than the pressure"
    order = 210

    quadratic: Scalar = parameter(
        0.0, 0.0, 3e-6, "1/Pa", "at 330 kPa, the moment per pressure doubles at most"
    )
    """q, relative growth of the moment per pressure."""

    def act(self, p, memory, dt):
        return p * (1.0 + self.quadratic * jnp.abs(p)), memory
