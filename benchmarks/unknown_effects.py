"""Effects that the library lacks, to test the loop's verdict on unknown causes.

Each effect has a size parameter, so that its detection limit can be computed. The loop gets the
library without these effects as its candidates.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.beam.parameters import Scalar
from slider_jax.effects import (
    ActingPressure,
    BendingMoment,
    Flow,
    ForceDensity,
    Instrument,
    WaterMotion,
    parameter,
)

WHY = "an assumption of the benchmark"


class CrackingValves(Flow):
    """The valves' springs hold the valves partly closed near the ambient pressure."""

    title = "valves that open late"
    size: Scalar = parameter(0.0, 0.0, 0.95, "-", WHY)

    def rate(self, rate, x):
        return rate * (1.0 - self.size * jnp.exp(-jnp.square(x.p / 4e4)))


class FoldingMembrane(Flow):
    """A chamber's membrane folds over the vent below 60 kPa, so only the last part vents slowly."""

    title = "membrane that folds over the vent"
    size: Scalar = parameter(0.0, 0.0, 0.95, "-", WHY)

    def rate(self, rate, x):
        low = jax.nn.sigmoid((6e4 - jnp.abs(x.p)) / 8e3)
        return rate * (1.0 - self.size * low * (1.0 - x.filling))


class SCurve(ActingPressure):
    """The sleeve's fabric makes the moment oscillate about its linear law as pressure rises."""

    title = "fabric with an S-shaped law"
    size: Scalar = parameter(0.0, 0.0, 4e4, "Pa", WHY)

    def act(self, p, memory, dt):
        return p + self.size * jnp.sin(2.0 * jnp.pi * p / 1.2e5), memory


class OneSidedQuadratic(ActingPressure):
    """The chambers of one side bulge, so their moment grows faster than their pressure."""

    title = "chambers of one side that bulge"
    size: Scalar = parameter(0.0, 0.0, 5e-6, "1/Pa", WHY)

    def act(self, p, memory, dt):
        return p + self.size * jnp.square(jnp.maximum(p, 0.0)), memory


class WrinklingWall(BendingMoment):
    """The inner wall buckles beyond a curvature of 2 1/m and then carries a smaller moment."""

    title = "inner wall that wrinkles"
    size: Scalar = parameter(0.0, 0.0, 0.9, "-", WHY)

    def moment(self, x, memory, dt):
        above = jnp.sign(x.kappa) * jnp.maximum(jnp.abs(x.kappa) - 2.0, 0.0)
        return -(1.0 - x.in_tail) * self.size * 0.038 * above, memory


class SnappingBody(BendingMoment):
    """The body resists small curvatures less: it snaps between two bent shapes."""

    title = "body that snaps"
    size: Scalar = parameter(0.0, 0.0, 0.9, "-", WHY)

    def moment(self, x, memory, dt):
        snap = x.kappa * jnp.exp(-jnp.square(x.kappa / 1.5))
        return -(1.0 - x.in_tail) * self.size * 0.038 * snap, memory


class OneSidedDamping(BendingMoment):
    """A tube rubs while the body bends to one side only."""

    title = "tube that rubs on one side"
    size: Scalar = parameter(0.0, 0.0, 3e-3, "N m^2 s", WHY)

    def moment(self, x, memory, dt):
        rate = 0.5 * (x.kappa_t + jnp.sqrt(x.kappa_t**2 + 1.0))
        return (1.0 - x.in_tail) * self.size * rate * jax.nn.sigmoid(x.kappa / 0.2), memory


class DragCrisis(ForceDensity):
    """The drag coefficient changes beyond a lateral speed of 0.4 m/s."""

    title = "drag crisis"
    size: Scalar = parameter(0.0, -3.0, 3.0, "-", WHY)

    def force(self, x):
        fast = jax.nn.sigmoid((jnp.abs(x.u_n) - 0.4) / 0.04)
        F_n = -500.0 * self.size * fast * x.height * jnp.abs(x.u_n) * x.u_n
        return jnp.zeros_like(F_n), F_n


class BodyFin(ForceDensity):
    """A fin at half of the length adds drag there."""

    title = "fin at half of the length"
    size: Scalar = parameter(0.0, 0.0, 12.0, "-", WHY)

    def force(self, x):
        at = jnp.exp(-jnp.square((x.s - 0.185) / 0.025))
        F_n = -500.0 * self.size * at * x.height * jnp.abs(x.u_n) * x.u_n
        return jnp.zeros_like(F_n), F_n


class PassingWave(WaterMotion):
    """Another machine causes a wave of 2.7 Hz across the tank."""

    title = "wave across the tank"
    size: Scalar = parameter(0.0, 0.0, 0.15, "m/s", WHY)

    def velocity(self, t):
        return jnp.zeros_like(t), self.size * jnp.sin(2.0 * jnp.pi * 2.7 * t)


class BentRecoilSensor(Instrument):
    """The force sensor is nonlinear: its recoil reading is F + c F^2."""

    title = "nonlinear recoil sensor"
    size: Scalar = parameter(0.0, -0.5, 0.5, "1/N", WHY)

    def read(self, true):
        return true._replace(recoil=true.recoil + self.size * true.recoil**2)


class BentThrustSensor(Instrument):
    """The force sensor saturates: its thrust reading is F + c |F|^(3/2) sign(F)."""

    title = "nonlinear thrust sensor"
    size: Scalar = parameter(0.0, -1.0, 1.0, "N^-1/2", WHY)

    def read(self, true):
        F = true.thrust
        return true._replace(thrust=F + self.size * F * jnp.sqrt(jnp.sqrt(F**2 + 1e-6)))


class TiltedCamera(Instrument):
    """The camera looks at the tank from the side, so its scale grows along the tip's path."""

    title = "tilted camera"
    size: Scalar = parameter(0.0, -8.0, 8.0, "1/m", WHY)

    def read(self, true):
        return true._replace(tip=true.tip * (1.0 + self.size * true.tip))


class MotorHum(Instrument):
    """The amplifier of the thrust picks up a motor of 13 Hz."""

    title = "hum of a motor"
    size: Scalar = parameter(0.0, 0.0, 0.3, "N", WHY)

    def read(self, true):
        hum = self.size * jnp.sin(2.0 * np.pi * 13.0 * true.t + 0.7)
        return true._replace(thrust=true.thrust + hum)


class WarmingSensor(Instrument):
    """The pressure sensors' sensitivity drifts during a trial."""

    title = "pressure sensor that warms up"
    sensors = ("pressure",)
    size: Scalar = parameter(0.0, 0.0, 0.3, "1/s", WHY)

    def read(self, true):
        gain = 1.0 + self.size * true.t
        return true._replace(pressures=gain * true.pressures)


class Whereabouts(NamedTuple):
    """Correct answers on where an unknown effect is."""

    channels: tuple[str, ...]
    """Channels that the effect changes."""
    places: tuple[str, ...]
    """Places of the library that describe the same part of the rig."""


PRESSURES, FORCES = ("p_front", "p_rear"), ("recoil", "tip", "thrust")
VALVES = ("Command", "Flow")
MOMENT = ("ActingPressure", "BendingMoment", "BodyChange")
WATER = ("ForceDensity", "WaterMotion")

UNKNOWN_EFFECTS = {
    "cracking_valves": Whereabouts(PRESSURES, VALVES),
    "folding_membrane": Whereabouts(PRESSURES, VALVES),
    "s_curve": Whereabouts(FORCES, MOMENT),
    "one_sided_quadratic": Whereabouts(FORCES, MOMENT),
    "wrinkling_wall": Whereabouts(FORCES, MOMENT),
    "snapping_body": Whereabouts(FORCES, MOMENT),
    "one_sided_damping": Whereabouts(FORCES, MOMENT),
    "drag_crisis": Whereabouts(FORCES, WATER),
    "body_fin": Whereabouts(FORCES, WATER),
    "passing_wave": Whereabouts(FORCES, WATER),
    "bent_recoil_sensor": Whereabouts(("recoil",), ("Instrument",)),
    "bent_thrust_sensor": Whereabouts(("thrust",), ("Instrument",)),
    "tilted_camera": Whereabouts(("tip",), ("Instrument",)),
    "motor_hum": Whereabouts(("thrust",), ("Instrument",)),
    "warming_sensor": Whereabouts(PRESSURES, ("Instrument", *VALVES)),
}
