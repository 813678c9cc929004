"""Places of the markers on the arm."""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp

from calibration.tentacle.arm import ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.effects.base import parameter

WHY = "placed by hand; distances differ by 10 mm between the sessions"


class MarkerPlace(AbstractArmEffect):
    """A marker sits elsewhere than stated: along the arm, or aside in direction n or b."""

    by_session: ClassVar[bool] = True
    along_1: float = parameter(0.0, -0.015, 0.015, "m", WHY)
    along_2: float = parameter(0.0, -0.015, 0.015, "m", WHY)
    along_3: float = parameter(0.0, -0.015, 0.015, "m", WHY)
    along_4: float = parameter(0.0, -0.015, 0.015, "m", WHY)
    n_1: float = parameter(0.0, -0.015, 0.015, "m", WHY)
    n_2: float = parameter(0.0, -0.015, 0.015, "m", WHY)
    n_3: float = parameter(0.0, -0.015, 0.015, "m", WHY)
    n_4: float = parameter(0.0, -0.015, 0.015, "m", WHY)
    b_1: float = parameter(0.0, -0.015, 0.015, "m", WHY)
    b_2: float = parameter(0.0, -0.015, 0.015, "m", WHY)
    b_3: float = parameter(0.0, -0.015, 0.015, "m", WHY)
    b_4: float = parameter(0.0, -0.015, 0.015, "m", WHY)

    def on(self, parts: ArmParts) -> ArmParts:
        more = jnp.array(
            [
                [self.along_1, self.along_2, self.along_3, self.along_4],
                [self.n_1, self.n_2, self.n_3, self.n_4],
                [self.b_1, self.b_2, self.b_3, self.b_4],
            ]
        )
        return replace(parts, offsets=parts.offsets + more.T)
