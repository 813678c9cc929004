"""Unweighed mass that moves with the body."""

import dataclasses

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BodyChange, parameter


class CarriedMass(BodyChange):
    """Mass of water in folds, of sensors and of tubes, distributed evenly along body and tail.

        m -> m + dm

    Unlike added mass of the water, this mass acts along and across the body.
    Source: balance of momentum; Newman, J. N. (1977), Marine Hydrodynamics, MIT Press, ch. 4.
    """

    title = "mass carried along by the body"
    order = 290

    dm: Scalar = parameter(
        0.0, 0.0, 0.4, "kg/m", "folds of 4 cm^2 hold 0.4; sensors and tubes weigh about 0.05"
    )
    """Additional mass per length."""

    def change(self, robot):
        return dataclasses.replace(robot, linear_density=robot.linear_density + self.dm)
