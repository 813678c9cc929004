"""A change of the damping of the material."""

import dataclasses
import math

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BodyChange, parameter


class MaterialDamping(BodyChange):
    """A change of the Kelvin-Voigt damping of body and tail.

        alpha -> alpha (1 + x)

    alpha is the damping time. If alpha is zero, the effect changes nothing.
    Source: Christensen, R. M. (1982), Theory of Viscoelasticity, 2nd ed., Academic Press, ch. 1.
    """

    title = "the material damps more or less"
    order = 280
    segments = ("body", "tail")
    serves_space = True

    x: Scalar = parameter(
        0.0,
        -0.9,
        4.0,
        "-",
        "the damping of rubber varies with batch, temperature and rate",
        physical=(-1.0, math.inf),
    )
    """x, relative change of the damping time."""

    def change(self, robot):
        return robot.with_parts(
            lambda part: dataclasses.replace(part, damping_time=part.damping_time * (1.0 + self.x))
        )
