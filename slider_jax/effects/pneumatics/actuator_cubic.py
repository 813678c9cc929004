"""An actuator with a cubic term in the pressure."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class ActuatorCubic(ActingPressure):
    """The moment has a cubic part, the first odd term after the linear one.

        p_act = p (1 + q p^2)

    `ActuatorSaturation` and `ActuatorQuadratic` deviate at small pressures; here the relative
    deviation increases with the square of the pressure. Source: Polygerinos, P. et al. (2015),
    Modeling of soft fiber-reinforced bending actuators, IEEE Trans. Robot. 31, 778-789.
    """

    title = "the actuators' moment is nonlinear at high pressure"
    order = 220

    q: Scalar = parameter(
        0.0, -4e-12, 6e-12, "1/Pa^2", "at 330 kPa two fifths less, or two thirds more"
    )
    """Coefficient of the cubic term."""

    def act(self, p, memory, dt):
        return p * (1.0 + self.q * p**2), memory
