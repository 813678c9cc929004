"""Curvature of the arm without loads."""

from dataclasses import replace

import jax.numpy as jnp

from calibration.tentacle.arm import ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.effects.base import parameter


class InitialBend(AbstractArmEffect):
    """The unloaded arm has a constant curvature, for example because it sagged while it cured."""

    about_n: float = parameter(0.0, -2.0, 2.0, "1/m", "130 mm at the tip: sag while curing")
    about_b: float = parameter(0.0, -2.0, 2.0, "1/m", "130 mm at the tip: sag while curing")

    def on(self, parts: ArmParts) -> ArmParts:
        more = jnp.array([0.0, self.about_n, self.about_b])
        rod = parts.rod
        return replace(parts, rod=replace(rod, initial_curvature=rod.initial_curvature + more))
