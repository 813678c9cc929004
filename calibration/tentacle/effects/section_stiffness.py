"""Stiffness of the section against bending and twist."""

from dataclasses import replace

import jax.numpy as jnp

from calibration.tentacle.arm import ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.effects.base import parameter


class SectionStiffness(AbstractArmEffect):
    """EI about n and b are EI (1 + flatness) and EI (1 - flatness); GJ is GJ (1 + twist).

    The channels of the tendons make the section less round. Poisson's ratio of 0.5 instead of 0.45
    is a twist of -0.03.
    """

    flatness: float = parameter(0.0, -0.3, 0.3, "-", "channels of the tendons in the wall")
    twist: float = parameter(0.0, -0.5, 0.5, "-", "Poisson's ratio, channels of the tendons")

    def on(self, parts: ArmParts) -> ArmParts:
        factor = 1.0 + jnp.array([self.twist, self.flatness, -self.flatness])
        return replace(parts, rod=replace(parts.rod, stiffness=parts.rod.stiffness * factor))
