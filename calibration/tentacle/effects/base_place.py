"""Place of the base in the frame of the markers."""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp

from calibration.tentacle.arm import ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.effects.base import parameter


class BasePlace(AbstractArmEffect):
    """The base is elsewhere than stated. The frame comes from a marker 33 mm beside the base."""

    by_session: ClassVar[bool] = True
    x: float = parameter(0.0, -0.015, 0.015, "m", "half of the distance of the base marker")
    y: float = parameter(0.0, -0.015, 0.015, "m", "half of the distance of the base marker")
    z: float = parameter(0.0, -0.015, 0.015, "m", "half of the distance of the base marker")

    def on(self, parts: ArmParts) -> ArmParts:
        return replace(parts, base=parts.base + jnp.array([self.x, self.y, self.z]))
