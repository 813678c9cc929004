"""Effects outside the library, to test the loop's verdict on unknown causes.

Each effect lists the channels that the effect changes, and the places of library effects that
describe the same part of the rig.
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
    """A valve that opens at a pressure and vents in proportion to the excess pressure."""

    opening: float = 1.2e5
    rate_above: float = 25.0

    def rate(self, rate, x):
        above = jnp.maximum(jnp.abs(x.p) - self.opening, 0.0)
        return rate - self.rate_above * jnp.sign(x.p) * above


class SidedValves(Flow):
    """One side of each antagonistic pair fills and vents more slowly: k is larger for p > 0."""

    share: float = 0.45

    def rate(self, rate, x):
        return rate * jnp.where(x.side > 0.0, 1.0 - self.share, 1.0)


class SidedMoment(ActingPressure):
    """The chambers of one side are farther from the axis, so these chambers' moment is larger."""

    share: float = 0.25

    def act(self, p, memory, dt):
        return p * jnp.where(p > 0.0, 1.0 + self.share, 1.0), memory


class SidedDrag(ForceDensity):
    """The cross-section is not symmetric, so the drag is larger for strokes to one side."""

    C: float = 2.5

    def force(self, x):
        F_n = -500.0 * self.C * x.height * jnp.abs(x.u_n) * jnp.maximum(x.u_n, 0.0)
        return jnp.zeros_like(F_n), F_n


class WrinklingWall(BendingMoment):
    """The inner wall buckles beyond a curvature and then carries a smaller moment."""

    onset: float = 3.0
    share: float = 0.4
    EI: float = 0.038

    def moment(self, x, memory, dt):
        above = jnp.sign(x.kappa) * jnp.maximum(jnp.abs(x.kappa) - self.onset, 0.0)
        return -(1.0 - x.in_tail) * self.share * self.EI * above, memory


class PassingWave(WaterMotion):
    """Another machine causes a wave of 2.7 Hz across the tank."""

    speed: float = 0.05

    def velocity(self, t):
        return jnp.zeros_like(t), self.speed * jnp.sin(2.0 * jnp.pi * 2.7 * t)


class BentForceSensor(Instrument):
    """The force sensor is nonlinear: its recoil reading is F + c F^2."""

    c: float = 0.25

    def read(self, true):
        return true._replace(recoil=true.recoil + self.c * true.recoil**2)


class BarrelLens(Instrument):
    """The lens reduces distances far from its axis: the reading is y (1 - c y^2)."""

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
    """The pressure sensors' sensitivity drifts during a trial."""

    rate: float = 0.08

    def read(self, true):
        gain = 1.0 + self.rate * true.t
        return true._replace(p_front=gain * true.p_front, p_rear=gain * true.p_rear)


class UnknownEffect(NamedTuple):
    """An effect outside the library, with the correct channels and places for the verdict."""

    effect: Callable[[], Effect]
    channels: tuple[str, ...]
    places: tuple[str, ...]


UNKNOWN_EFFECTS = {
    "relief_valve": UnknownEffect(ReliefValve, ("p_front", "p_rear"), PRESSURE),
    "sided_valves": UnknownEffect(SidedValves, ("p_front", "p_rear"), PRESSURE),
    "sided_moment": UnknownEffect(SidedMoment, ("recoil", "tip", "thrust"), MOMENT),
    "sided_drag": UnknownEffect(
        SidedDrag, ("recoil", "tip", "thrust"), ("ForceDensity", "WaterMotion")
    ),
    "wrinkling_wall": UnknownEffect(WrinklingWall, ("recoil", "tip", "thrust"), MOMENT),
    "passing_wave": UnknownEffect(PassingWave, ("recoil", "tip", "thrust"), ("WaterMotion",)),
    "bent_force_sensor": UnknownEffect(BentForceSensor, ("recoil",), ("Instrument",)),
    "barrel_lens": UnknownEffect(BarrelLens, ("tip",), ("Instrument",)),
    "hum": UnknownEffect(Hum, ("thrust",), ("Instrument",)),
    "warming_sensor": UnknownEffect(WarmingSensor, ("p_front", "p_rear"), ("Instrument", "Flow")),
}
