"""Mass that moves with the body and is not in the measured mass."""

import dataclasses

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BodyChange, parameter


class CarriedMass(BodyChange):
    """Mass of water in folds, of sensors and of tubes, distributed evenly along body and tail.

        m -> m + dm

    Unlike the added mass of the water in the base model, dm also resists axial acceleration.
    Source: balance of momentum; Newman, J. N. (1977), Marine Hydrodynamics, MIT Press, ch. 4.
    """

    title = "mass carried along by the body"
    order = 290
    segments = ("body", "tail")
    serves_space = True

    dm: Scalar = parameter(
        0.0, 0.0, 0.4, "kg/m", "0.4 for water in folds of 4 cm^2; 0.05 for sensors and tubes"
    )
    """dm, additional mass per length."""

    def change(self, robot):
        return robot.with_parts(
            lambda part: dataclasses.replace(part, linear_density=part.linear_density + self.dm)
        )
