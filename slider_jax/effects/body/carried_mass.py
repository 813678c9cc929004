"""Unweighed mass that moves with the body."""

import dataclasses

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BodyChange, parameter


class CarriedMass(BodyChange):
    """Water held in folds, sensors and tubes, distributed evenly over body and tail.

        m -> m + dm

    Unlike added mass of the water, it acts both along and across the body.
    Source: balance of momentum; Newman, J. N. (1977), Marine Hydrodynamics, MIT Press, ch. 4.
    """

    title = "mass carried along by the body"
    order = 290

    dm: Scalar = parameter(
        0.0, 0.0, 0.4, "kg/m", "water in 4 cm^2 of folds; sensors and tubes weigh about 0.05"
    )
    """Mass per length."""

    def change(self, robot):
        return dataclasses.replace(robot, linear_density=robot.linear_density + self.dm)
