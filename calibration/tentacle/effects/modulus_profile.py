"""Modulus that varies along the arm."""

from dataclasses import replace

from calibration.tentacle.arm import LENGTH, ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.effects.base import parameter


class ModulusProfile(AbstractArmEffect):
    """Young's modulus is E (1 + slope (s/L - 1/2))."""

    slope: float = parameter(0.0, -1.0, 1.0, "-", "incomplete mixing or curing of the material")

    def on(self, parts: ArmParts) -> ArmParts:
        factor = 1.0 + self.slope * (parts.rod.s / LENGTH - 0.5)
        rod = parts.rod
        EA = None if rod.EA is None else rod.EA * factor
        return replace(parts, rod=replace(rod, stiffness=rod.stiffness * factor[:, None], EA=EA))
