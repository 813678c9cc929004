"""A tail stiffer or softer than measured."""

import math
from dataclasses import replace

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BodyChange, parameter


class TailStiffness(BodyChange):
    """A change of the bending stiffness of the passive tail.

        EI_tail -> EI_tail (1 + x)

    Source: Euler-Bernoulli beam; EI scales with the cube of a sheet's thickness, Gere, J. M. and
    Timoshenko, S. P. (1997), Mechanics of Materials, 4th ed., ch. 5.
    """

    title = "a tail stiffer or softer than stated"
    order = 270
    segments = ("tail",)

    x: Scalar = parameter(
        0.0,
        -0.5,
        0.8,
        "-",
        "a sheet thicker by a sixth has 1.6 times EI; the joint changes EI too",
        physical=(-0.95, math.inf),
    )
    """x, relative change of EI_tail."""

    def change(self, robot):
        tail = robot.tail
        return replace(robot, tail=replace(tail, EI=tail.EI * (1.0 + self.x)))
