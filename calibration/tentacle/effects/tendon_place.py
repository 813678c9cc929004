"""Places of the tendons in the section."""

from dataclasses import replace

import jax.numpy as jnp

from calibration.tentacle.arm import TENDON_END, ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.effects.base import parameter
from slider_jax.rod.loads import RodTendon


class TendonPlace(AbstractArmEffect):
    """The tendons run at another distance from the axis, or at another angle around it.

    A tendon with clearance in its channel lies on the inner side of the bend, so its distance may
    be larger than that of the channel. `angle` turns both tendons from n towards b. `approach`
    turns tendon 1 forwards and tendon 2 back by the same angle.
    """

    at_base: float = parameter(0.0, -2e-3, 2e-3, "m", "accuracy of the mould, clearance")
    at_end: float = parameter(0.0, -2e-3, 2e-3, "m", "accuracy of the mould, clearance")
    angle: float = parameter(0.0, -0.2, 0.2, "rad", "accuracy of the mould")
    approach: float = parameter(0.0, -0.2, 0.2, "rad", "accuracy of the mould")

    def on(self, parts: ArmParts) -> ArmParts:
        turns = self.angle + self.approach, self.angle - self.approach
        moved = [
            self._moved(x, turn, parts.rod.s) for x, turn in zip(parts.tendons, turns, strict=True)
        ]
        return replace(parts, tendons=tuple(moved))

    def _moved(self, tendon: RodTendon, turn, s) -> RodTendon:
        side = tendon.offset / jnp.linalg.norm(tendon.offset, axis=1, keepdims=True)
        ahead = jnp.minimum(s / TENDON_END, 1.0)[:, None]
        out = self.at_base * (1.0 - ahead) + self.at_end * ahead
        slope = (self.at_end - self.at_base) / TENDON_END
        cosine, sine = jnp.cos(turn), jnp.sin(turn)
        turned = jnp.array([[cosine, sine], [-sine, cosine]])
        return replace(
            tendon,
            offset=(tendon.offset + out * side) @ turned,
            offset_slope=(tendon.offset_slope + slope * side) @ turned,
        )
