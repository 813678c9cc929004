"""An actuator with a cubic term in the pressure."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter


class ActuatorCubic(ActingPressure):
    """The moment of a chamber has a part that is cubic in the pressure p.

        p_act = p (1 + q p^2)

    p_act is the pressure that bends the body. At small pressures, `ActuatorSaturation` and
    `ActuatorQuadratic` change the moment more than this effect does. Source: Polygerinos, P. et al.
    (2015), Modeling of soft fiber-reinforced bending actuators, IEEE Trans. Robot. 31, 778-789.
    """

    title = "the actuators' moment is nonlinear at high pressure"
    order = 220

    q: Scalar = parameter(
        0.0, -4e-12, 6e-12, "1/Pa^2", "at 330 kPa, the moment is 44 % smaller to 65 % larger"
    )
    """q, coefficient of the cubic term."""

    def act(self, p, memory, dt):
        return p * (1.0 + self.q * p**2), memory
