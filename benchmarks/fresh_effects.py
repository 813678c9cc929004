"""Further effects that the library lacks. No term was changed after they were simulated.

The effects of `unknown_effects` were examined while the dictionary of terms was developed, so they
are no independent test. These effects were written before their first simulation. Afterwards, two
of them turned out to have laws of the library: `TornWall` is a relief valve (`relief_leak`), and
`CreepingBeam` is a force sensor that warms up (`force_warm_up`).
"""

import jax.numpy as jnp
from unknown_effects import FORCES, MOMENT, PRESSURES, VALVES, WATER, WHY, Whereabouts

from slider_jax.beam.parameters import Scalar
from slider_jax.effects import BendingMoment, Flow, ForceDensity, Instrument, WaterMotion, parameter


class ChatteringValves(Flow):
    """The valves chatter at small openings, so they pass less air if p is near p_set."""

    title = "valves that chatter"
    size: Scalar = parameter(0.0, 0.0, 0.95, "-", WHY)

    def rate(self, rate, x):
        return rate * (1.0 - self.size * jnp.exp(-jnp.square((x.p_set - x.p) / 2e4)))


class TornWall(Flow):
    """A tear in the chamber's wall opens above 120 kPa."""

    title = "torn wall"
    size: Scalar = parameter(0.0, 0.0, 8.0, "1/s", WHY)

    def rate(self, rate, x):
        return rate - self.size * jnp.sign(x.p) * jnp.maximum(jnp.abs(x.p) - 1.2e5, 0.0)


class LongHose(Flow):
    """A long hose slows the filling at high pressure, but not the venting."""

    title = "hose that slows the filling"
    size: Scalar = parameter(0.0, 0.0, 0.95, "-", WHY)

    def rate(self, rate, x):
        return rate * jnp.where(x.filling, 1.0 - self.size * jnp.abs(x.p) / 2.5e5, 1.0)


class BarbedTail(ForceDensity):
    """Barbs on one side of the tail add drag while the tail moves to this side."""

    title = "barbs on one side of the tail"
    size: Scalar = parameter(0.0, 0.0, 12.0, "-", WHY)

    def force(self, x):
        u = jnp.maximum(x.u_n, 0.0)
        F_n = -500.0 * self.size * x.in_tail * x.height * u**2
        return jnp.zeros_like(F_n), F_n


class ViscousSuction(ForceDensity):
    """The wake pulls the body backwards in proportion to the lateral speed."""

    title = "suction of the wake"
    size: Scalar = parameter(0.0, 0.0, 20.0, "N s/m^2", WHY)

    def force(self, x):
        F_tau = -self.size * jnp.sqrt(jnp.square(x.u_n) + 1e-4)
        return F_tau, jnp.zeros_like(F_tau)


class GluedTail(BendingMoment):
    """A glued seam stiffens the tail while it bends to one side."""

    title = "glued seam on one side of the tail"
    size: Scalar = parameter(0.0, 0.0, 5.0, "-", WHY)

    def moment(self, x, memory, dt):
        return x.EI * x.in_tail * self.size * jnp.maximum(x.kappa, 0.0), memory


class InflatedDamping(BendingMoment):
    """The wall of an inflated chamber rubs against the sleeve: the damping grows with |p|."""

    title = "damping that grows with the pressure"
    size: Scalar = parameter(0.0, 0.0, 1e-7, "N m^2 s/Pa", WHY)

    def moment(self, x, memory, dt):
        p = jnp.sqrt(jnp.square(x.pressure) + 1e6)
        return (1.0 - x.in_tail) * self.size * p * x.kappa_t, memory


class CreasedSleeve(BendingMoment):
    """The damping moment of the creased sleeve grows with the square root of the bending rate."""

    title = "damping with a square root"
    size: Scalar = parameter(0.0, 0.0, 0.05, "N m (m s)^(1/2)", WHY)

    def moment(self, x, memory, dt):
        rate = x.kappa_t
        root = rate / jnp.sqrt(jnp.sqrt(jnp.square(rate) + 1.0))
        return (1.0 - x.in_tail) * self.size * root, memory


class LooseBeam(Instrument):
    """The bending beam of the thrust sensor is loose, so small forces hardly move it."""

    title = "loose beam of the thrust sensor"
    size: Scalar = parameter(0.0, 0.0, 1.0, "-", WHY)

    def read(self, true):
        F = true.thrust
        return true._replace(thrust=F * (1.0 - self.size * jnp.exp(-jnp.square(F / 0.08))))


class ShakingMast(Instrument):
    """The camera's mast shakes at 7.3 Hz."""

    title = "mast of the camera that shakes"
    size: Scalar = parameter(0.0, 0.0, 0.02, "m", WHY)

    def read(self, true):
        shift = self.size * jnp.sin(2.0 * jnp.pi * 7.3 * true.t + 0.3)
        return true._replace(tip=true.tip + shift)


class CreepingBeam(Instrument):
    """The recoil sensor's zero creeps after each start."""

    title = "recoil sensor that creeps"
    size: Scalar = parameter(0.0, 0.0, 2.0, "N", WHY)

    def read(self, true):
        creep = self.size * (1.0 - jnp.exp(-true.t / 0.8))
        return true._replace(recoil=true.recoil + creep)


class Stirrer(WaterMotion):
    """A stirrer moves the water along the tank at 1.1 Hz."""

    title = "stirrer in the tank"
    size: Scalar = parameter(0.0, 0.0, 0.3, "m/s", WHY)

    def velocity(self, t):
        return self.size * jnp.sin(2.0 * jnp.pi * 1.1 * t + 1.0), jnp.zeros_like(t)


FRESH_EFFECTS = {
    "chattering_valves": Whereabouts(PRESSURES, VALVES),
    "torn_wall": Whereabouts(PRESSURES, VALVES),
    "long_hose": Whereabouts(PRESSURES, VALVES),
    "barbed_tail": Whereabouts(FORCES, WATER),
    "viscous_suction": Whereabouts(FORCES, WATER),
    "glued_tail": Whereabouts(FORCES, MOMENT),
    "inflated_damping": Whereabouts(FORCES, MOMENT),
    "creased_sleeve": Whereabouts(FORCES, MOMENT),
    "loose_beam": Whereabouts(("thrust",), ("Instrument",)),
    "shaking_mast": Whereabouts(("tip",), ("Instrument",)),
    "creeping_beam": Whereabouts(("recoil",), ("Instrument",)),
    "stirrer": Whereabouts(FORCES, WATER),
}
