"""An actuator whose moment bends away from a straight line at high pressure."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class ActuatorCubic(ActingPressure):
    """The first odd term after the linear one.

        p_act = p (1 + q p^2)

    `ActuatorSaturation` and `ActuatorQuadratic` depart from the line from the beginning, this one
    with the square of the pressure. Source: Polygerinos, P. et al. (2015), Modeling of soft
    fiber-reinforced bending actuators, IEEE Trans. Robot. 31, 778-789.
    """

    title = "the moment departs from the pressure's line at high pressure"
    order = 220

    q: Scalar = parameter(
        0.0, -4e-12, 6e-12, "1/Pa^2", "at 330 kPa two fifths less, or two thirds more"
    )
    """Of the cubic term."""

    def act(self, p, memory, dt):
        return p * (1.0 + self.q * p**2), memory
