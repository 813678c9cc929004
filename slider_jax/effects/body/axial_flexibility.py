"""A body that stretches."""

from dataclasses import replace

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BodyChange, parameter


class AxialFlexibility(BodyChange):
    """Additional axial compliance of the actuated body, in series with the compliance 1/EA_body.

        1/EA_body -> 1/EA_body + c

    Source: springs in series, Gere, J. M. and Timoshenko, S. P. (1997), Mechanics of Materials,
    4th ed., ch. 2.
    """

    title = "the body stretches"
    order = 300
    segments = ("body",)
    serves_space = True

    compliance: Scalar = parameter(
        0.0, 0.0, 4e-3, "1/N", "1/EA is 2e-3 for EI = 0.038 N m^2 and walls 8 mm from the midline"
    )
    """c, axial strain per axial force."""

    def change(self, robot):
        body = robot.body
        EA = body.EA / (1.0 + self.compliance * body.EA)
        return replace(robot, body=replace(body, EA=EA))
