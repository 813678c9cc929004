"""Friction of the tendons in the wall of the arm."""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp

from calibration.tentacle.arm import ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.effects.base import parameter


class CapstanFriction(AbstractArmEffect):
    """The tension falls along the arm by exp(-mu angle), with the angle of bending up to the place.

    The tensions rose before each run. Source: capstan equation (Euler-Eytelwein).
    """

    uses_strains: ClassVar[bool] = True
    mu: float = parameter(
        0.0, -0.3, 0.3, "-", "silicone with a lining; below 0 if the tension fell before the run"
    )

    def on(self, parts: ArmParts) -> ArmParts:
        s, ds = parts.rod.s, parts.rod.ds
        # The small term keeps the derivative of the square root finite.
        bending = jnp.sqrt(jnp.sum(parts.strains[:, 1:3] ** 2, axis=1) + 1e-16)
        ahead = jnp.cumsum(ds) - s
        loss = jnp.exp(-self.mu * (jnp.cumsum(bending * ds) - bending * ahead))
        return replace(
            parts, tendons=tuple(replace(x, share=x.share * loss) for x in parts.tendons)
        )
