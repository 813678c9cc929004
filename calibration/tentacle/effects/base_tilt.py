"""Orientation of the clamp."""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp

from calibration.tentacle.arm import ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.effects.base import parameter
from slider_jax.rod.rotations import rotation


class BaseTilt(AbstractArmEffect):
    """The clamp is turned about the axes x, y and z of the frame at the base."""

    by_session: ClassVar[bool] = True
    about_x: float = parameter(0.0, -0.1, 0.1, "rad", "6 deg: mounting, axes of the cameras")
    about_y: float = parameter(0.0, -0.1, 0.1, "rad", "6 deg: mounting, axes of the cameras")
    about_z: float = parameter(0.0, -0.1, 0.1, "rad", "6 deg: mounting, axes of the cameras")

    def on(self, parts: ArmParts) -> ArmParts:
        turn = rotation(jnp.array([self.about_x, self.about_y, self.about_z]))
        return replace(parts, rod=replace(parts.rod, clamp=turn @ parts.rod.clamp))
