"""Material that stiffens or softens with strain."""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp

from calibration.tentacle.arm import RADII, ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.effects.base import parameter


class StrainStiffening(AbstractArmEffect):
    """The bending stiffness is EI (1 + growth (kappa r)^2), with curvature kappa and radius r.

    kappa r is the largest strain of bending; it is about 0.1 in the strongest bend.
    """

    uses_strains: ClassVar[bool] = True
    growth: float = parameter(0.0, -20.0, 20.0, "-", "20 % at a strain of 0.1: hyperelastic rubber")

    def on(self, parts: ArmParts) -> ArmParts:
        radius = jnp.interp(parts.rod.s, *jnp.array(RADII).T)
        strain = jnp.sum(parts.strains[:, 1:3] ** 2, axis=1) * radius**2
        factor = jnp.ones_like(parts.rod.stiffness).at[:, 1:].add(self.growth * strain[:, None])
        return replace(parts, rod=replace(parts.rod, stiffness=parts.rod.stiffness * factor))
