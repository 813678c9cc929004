"""Gain of the sensors of the tensions."""

from dataclasses import replace
from typing import ClassVar

from calibration.tentacle.arm import ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.effects.base import parameter


class TensionGain(AbstractArmEffect):
    """The tension of a tendon is the stated tension times 1 + gain.

    The source computes the tension from a load and the radius of a pulley. An error of either is a
    gain. A gain that both tendons share acts like another modulus and density.
    """

    by_session: ClassVar[bool] = True
    tendon_1: float = parameter(0.0, -0.2, 0.2, "-", "calibration of a load cell, pulley radius")
    tendon_2: float = parameter(0.0, -0.2, 0.2, "-", "calibration of a load cell, pulley radius")

    def on(self, parts: ArmParts) -> ArmParts:
        gains = self.tendon_1, self.tendon_2
        tendons = zip(parts.tendons, gains, strict=True)
        return replace(
            parts, tendons=tuple(replace(x, tension=x.tension * (1.0 + g)) for x, g in tendons)
        )
