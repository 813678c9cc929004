"""A body stiffer or softer than measured."""

import math
from dataclasses import replace

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BodyChange, parameter


class BodyStiffness(BodyChange):
    """A change of the bending stiffness of the actuated body.

        EI_body -> EI_body (1 + x)

    Source: Gent, A. N. (2012), Engineering with Rubber, 3rd ed., Hanser, ch. 3.
    """

    title = "a body stiffer or softer than stated"
    order = 260
    segments = ("body",)

    x: Scalar = parameter(
        0.0,
        -0.3,
        0.4,
        "-",
        "10 % error of bending tests, and effects of age, tubes and a sleeve",
        physical=(-0.95, math.inf),
    )
    """x, relative change of EI_body."""

    def change(self, robot):
        body = robot.body
        return replace(robot, body=replace(body, EI=body.EI * (1.0 + self.x)))
