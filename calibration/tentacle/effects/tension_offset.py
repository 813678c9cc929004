"""Tension that is lost before the arm, or the zero of a load cell."""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp

from calibration.tentacle.arm import ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.effects.base import parameter


class TensionOffset(AbstractArmEffect):
    """The tension of a pulled tendon is the stated tension minus an offset.

    Dry friction of the pulley, slack of the tendon and a wrong zero of the load cell have this
    effect. A tendon cannot push.
    """

    by_session: ClassVar[bool] = True
    both: float = parameter(0.0, -1.0, 1.0, "N", "dry friction at the pulleys, zero of the cells")
    tendon_1: float = parameter(0.0, -1.0, 1.0, "N", "dry friction at the pulley, zero of the cell")
    tendon_2: float = parameter(0.0, -1.0, 1.0, "N", "dry friction at the pulley, zero of the cell")

    def on(self, parts: ArmParts) -> ArmParts:
        lost = self.both + self.tendon_1, self.both + self.tendon_2
        tendons = zip(parts.tendons, lost, strict=True)
        return replace(
            parts, tendons=tuple(replace(x, tension=_left(x.tension, off)) for x, off in tendons)
        )


def _left(tension, lost):
    return jnp.where(tension > 0.0, jnp.maximum(tension - lost, 0.0), 0.0)
