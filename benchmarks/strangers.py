"""Effects that the library does not hold, to test what the loop says of them.

Each has the channels in which it acts and the places at which an effect of the library would stand
for the same part of the rig.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from slider_jax.effects import (
    ActingPressure,
    BendingMoment,
    Effect,
    Flow,
    ForceDensity,
    Instrument,
    WaterMotion,
)

PRESSURE = ("Command", "Flow")
MOMENT = ("ActingPressure", "BendingMoment", "BodyChange")


class ReliefValve(Flow):
    """Opens at a pressure and vents in proportion to what is above."""

    opening: float = 1.2e5
    rate_above: float = 25.0

    def rate(self, rate, x):
        above = jnp.maximum(jnp.abs(x.p) - self.opening, 0.0)
        return rate - self.rate_above * jnp.sign(x.p) * above


class SidedValves(Flow):
    """One side of each antagonistic pair fills and vents slower: k is larger for p > 0."""

    share: float = 0.45

    def rate(self, rate, x):
        return rate * jnp.where(x.side > 0.0, 1.0 - self.share, 1.0)


class SidedMoment(ActingPressure):
    """The chambers of one side are glued on farther from the axis: their moment is larger."""

    share: float = 0.25

    def act(self, p, memory, dt):
        return p * jnp.where(p > 0.0, 1.0 + self.share, 1.0), memory


class SidedDrag(ForceDensity):
    """The cross-section is not symmetric: strokes to one side meet more drag."""

    C: float = 2.5

    def force(self, x):
        F_n = -500.0 * self.C * x.height * jnp.abs(x.u_n) * jnp.maximum(x.u_n, 0.0)
        return jnp.zeros_like(F_n), F_n


class WrinklingWall(BendingMoment):
    """The inner wall buckles where it is bent beyond a curvature and carries less from there."""

    onset: float = 3.0
    share: float = 0.4
    EI: float = 0.038

    def moment(self, x, memory, dt):
        above = jnp.sign(x.kappa) * jnp.maximum(jnp.abs(x.kappa) - self.onset, 0.0)
        return -(1.0 - x.in_tail) * self.share * self.EI * above, memory


class PassingWave(WaterMotion):
    """A wave of another machine's making runs across the tank at 2.7 Hz."""

    speed: float = 0.05

    def velocity(self, t):
        return jnp.zeros_like(t), self.speed * jnp.sin(2.0 * jnp.pi * 2.7 * t)


class BentForceSensor(Instrument):
    """The force sensor's characteristic is bent: it reads F + c F^2 of the recoil."""

    c: float = 0.25

    def read(self, true):
        return true._replace(recoil=true.recoil + self.c * true.recoil**2)


class BarrelLens(Instrument):
    """The lens shrinks what is far from the axis: y (1 - c y^2)."""

    c: float = 60.0

    def read(self, true):
        return true._replace(tip=true.tip * (1.0 - self.c * true.tip**2))


class Hum(Instrument):
    """The amplifier of the thrust picks up a motor of 13 Hz."""

    size: float = 0.08

    def read(self, true):
        return true._replace(
            thrust=true.thrust + self.size * jnp.sin(2.0 * np.pi * 13.0 * true.t + 0.7)
        )


class WarmingSensor(Instrument):
    """The pressure sensors' sensitivity creeps while a trial lasts."""

    rate: float = 0.08

    def read(self, true):
        gain = 1.0 + self.rate * true.t
        return true._replace(p_front=gain * true.p_front, p_rear=gain * true.p_rear)


class Stranger(NamedTuple):
    """An effect outside the library, and what would be right to say of it."""

    effect: Callable[[], Effect]
    channels: tuple[str, ...]
    places: tuple[str, ...]


STRANGERS = {
    "relief_valve": Stranger(ReliefValve, ("p_front", "p_rear"), PRESSURE),
    "sided_valves": Stranger(SidedValves, ("p_front", "p_rear"), PRESSURE),
    "sided_moment": Stranger(SidedMoment, ("recoil", "tip", "thrust"), MOMENT),
    "sided_drag": Stranger(SidedDrag, ("recoil", "tip", "thrust"), ("ForceDensity", "WaterMotion")),
    "wrinkling_wall": Stranger(WrinklingWall, ("recoil", "tip", "thrust"), MOMENT),
    "passing_wave": Stranger(PassingWave, ("recoil", "tip", "thrust"), ("WaterMotion",)),
    "bent_force_sensor": Stranger(BentForceSensor, ("recoil",), ("Instrument",)),
    "barrel_lens": Stranger(BarrelLens, ("tip",), ("Instrument",)),
    "hum": Stranger(Hum, ("thrust",), ("Instrument",)),
    "warming_sensor": Stranger(WarmingSensor, ("p_front", "p_rear"), ("Instrument", "Flow")),
}
