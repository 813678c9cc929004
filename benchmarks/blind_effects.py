"""Effects that the library lacks, named without knowledge of the terms that the loop can learn.

The list was written from the docstrings of the library's effects, the places of a model, and the
lists `unknown_effects` and `fresh_effects`. Its author had read neither the dictionary of terms nor
the code that learns from it, but had seen the shared functions in `slider_jax.effects.functions`.
Several laws depend on two states, on the past or on both chambers. Before the loop ran on the list,
three prior ranges were widened to include ten detection limits (`LooseningSeam`, `TrailingHose` and
`RollingShutter`). The range of `CreasedTail` includes three limits only.
"""

import jax
import jax.numpy as jnp
import numpy as np
from unknown_effects import FORCES, MOMENT, PRESSURES, VALVES, WATER, WHY, Whereabouts

from slider_jax.actuation.waveform import Segment, Waveform
from slider_jax.beam.parameters import Scalar
from slider_jax.effects import (
    ActingPressure,
    BendingMoment,
    Command,
    Flow,
    ForceDensity,
    Instrument,
    WaterMotion,
    parameter,
)
from slider_jax.effects.body.internal_friction import dahl_state
from slider_jax.effects.functions import delayed, lag_coefficients, lagged


class LeakyBulkhead(Flow):
    """Air leaks through a pinhole in the glued wall between the front and the rear chamber.

        dp/dt = (p_set - p)/k - q d (p_r/(d^2 + w^2)^(1/2))^(1/2),    d = p - p_other

    The flow of an orifice grows with the square root of the pressure difference d. It is laminar
    below w = 20 kPa. The reference pressure p_r is 100 kPa.
    """

    title = "leak between front and rear chamber"
    size: Scalar = parameter(0.0, 0.0, 5.0, "1/s", WHY)

    def rate(self, rate, x):
        d = x.p - x.p[::-1]
        return rate - self.size * d * jnp.sqrt(1e5 / jnp.sqrt(d**2 + 2e4**2))


class SharedSupply(Flow):
    """Both chambers fill from one thin hose, so each chamber fills slower while the other fills.

        dp/dt = (p_set - p)/k (1 - c D/(D + 1 MPa/s))    while |p| increases

    D is the rate at which the other chamber takes air. It is smooth near zero pressure.
    """

    title = "supply hose shared by both chambers"
    size: Scalar = parameter(0.0, 0.0, 0.95, "-", WHY)

    def rate(self, rate, x):
        gain = jnp.tanh(x.p / 2e4) * (x.p_set - x.p) / x.k
        taken = (0.5 * (gain + jnp.sqrt(gain**2 + 1e5**2)))[::-1]
        return rate * jnp.where(x.filling, 1.0 - self.size * taken / (taken + 1e6), 1.0)


class Stretched(Waveform):
    """The set pressure wave(t (1 - share)), as a clock that is slow by `share` generates it."""

    wave: Waveform
    share: Scalar

    def segment(self, t0, t1):
        speed = 1.0 - self.share
        x = self.wave.segment(t0 * speed, t1 * speed)
        return Segment(t0, jnp.clip(x.t_break / speed, t0, t1), t1, x.a0, x.a1, x.b0, x.b1)


class SlowClock(Command):
    """The ceramic resonator of the valves' controller is slow, so all strides are too long.

        p_set,valve(t) = p_set((1 - c) t)

    The force sensor, the pressure sensors and the camera have a correct clock.
    """

    title = "slow clock of the controller"
    size: Scalar = parameter(0.0, -0.05, 0.05, "-", WHY)

    def command(self, wave, rear):
        return Stretched(wave, self.size)


class Ringing(Waveform):
    """The set pressure wave(t) (1 - share exp(-t/0.6 s) cos(2 pi 3.4 Hz t))."""

    wave: Waveform
    share: Scalar

    def segment(self, t0, t1):
        def factor(t):
            return 1.0 - self.share * jnp.exp(-t / 0.6) * jnp.cos(2.0 * np.pi * 3.4 * t)

        x = self.wave.segment(t0, t1)
        start, middle, end = (factor(t) for t in (x.t0, x.t_break, x.t1))
        return Segment(
            x.t0, x.t_break, x.t1, start * x.a0, middle * x.a1, middle * x.b0, end * x.b1
        )


class RingingRegulator(Command):
    """The operator opens the supply at the start of a trial, and the pressure regulator rings.

    p_set,valve(t) = p_set(t) (1 - c exp(-t/0.6 s) cos(2 pi 3.4 Hz t))
    """

    title = "regulator that rings after the start"
    size: Scalar = parameter(0.0, 0.0, 0.5, "-", WHY)

    def command(self, wave, rear):
        return Ringing(wave, self.size)


class LooseningSeam(ActingPressure):
    """The glue between chamber and sleeve peels with every cycle, so the moment decreases.

        p_act = p/(1 + c S),    dS/dt = |p| |dp/dt|/(100 kPa 10 MPa)

    S measures the work of the pressure since the start of the trial. The glue sets between trials.
    """

    title = "glued seam that peels during a trial"
    size: Scalar = parameter(0.0, 0.0, 3.0, "-", WHY)

    def act(self, p, memory, dt):
        work, before = memory
        work = work + jnp.abs(0.5 * (p + before)) / 1e5 * jnp.abs(p - before)
        return p / (1.0 + self.size * work / 1e7), jnp.stack([work, p])


class CollapsingTube(ActingPressure):
    """The soft tube behind the pressure sensor is flat near ambient pressure and round above.

        tau dy/dt = p - y,    tau = c exp(-(p/40 kPa)^2)

    The pressure y bends the body. The flat tube passes little air.
    """

    title = "soft tube that collapses near ambient pressure"
    size: Scalar = parameter(0.0, 0.0, 0.3, "s", WHY)

    def act(self, p, memory, dt):
        y, before = memory
        e, m = lag_coefficients(self.size * jnp.exp(-jnp.square(p / 4e4)), dt)
        y = p + e * (y - before) - m * (p - before)
        return y, jnp.stack([y, p])


class ThixotropicSleeve(BendingMoment):
    """Work softens the filled rubber of the sleeve, and rest restores the rubber (Payne effect).

    M = EI kappa (1 - c q/(q + 4/m^2)),    0.3 s dq/dt = kappa^2 - q
    """

    title = "sleeve that softens under work"
    size: Scalar = parameter(0.0, 0.0, 0.8, "-", WHY)

    def moment(self, x, memory, dt):
        q = (memory + dt / 0.3 * jnp.square(x.kappa)) / (1.0 + dt / 0.3)
        return -(1.0 - x.in_tail) * self.size * x.EI * x.kappa * q / (q + 4.0), q


class GrippingSleeve(BendingMoment):
    """The pressure presses the chamber's wall against the fabric sleeve, which slips with friction.

        M = EI kappa + c |p| q,    0.4/m dq/dt = d(kappa)/dt - |d(kappa)/dt| q

    The friction is proportional to the pressure in the chamber. It does not depend on the rate.
    """

    title = "dry friction of the sleeve that grows with the pressure"
    size: Scalar = parameter(0.0, 0.0, 2e-7, "N m/Pa", WHY)

    def moment(self, x, memory, dt):
        q = dahl_state(memory, x.kappa_t, dt, 0.4)
        return (1.0 - x.in_tail) * self.size * jnp.abs(x.pressure) * q, q


class CreasedTail(BendingMoment):
    """A crease across the sheet, from handling, makes the middle of the tail softer.

    M = EI (1 - c exp(-((s - 35 mm)/12 mm)^2)) (kappa + alpha d(kappa)/dt)
    """

    title = "crease across the tail"
    size: Scalar = parameter(0.0, 0.0, 0.95, "-", WHY)

    def moment(self, x, memory, dt):
        at = x.in_tail * jnp.exp(-jnp.square((x.s - 0.035) / 0.012))
        return -self.size * at * x.EI * (x.kappa + x.damping_time * x.kappa_t), memory


class TrailingHose(ForceDensity):
    """The rear chamber's air hose leaves the body between the chambers and trails in the water.

        F = -rho A (|u| u/2 + 4 mm du/dt) exp(-((s - 0.22 m)/0.02 m)^2)/(0.02 m pi^(1/2))

    The force acts along both directions of the body, because the hose is slack. A is the hose's
    length times its diameter and drag coefficient. The second term is the hose's added mass.
    """

    title = "air hose that trails in the water"
    size: Scalar = parameter(0.0, 0.0, 8e-3, "m^2", WHY)

    def force(self, x):
        at = jnp.exp(-jnp.square((x.s - 0.22) / 0.02)) / (0.02 * np.sqrt(np.pi))
        speed = jnp.sqrt(x.u_tau**2 + x.u_n**2 + 1e-6)
        a_tau, a_n = x.u_tau_t - x.omega * x.u_n, x.u_n_t + x.omega * x.u_tau
        factor = -1000.0 * self.size * at
        return (
            factor * (0.5 * speed * x.u_tau + 4e-3 * a_tau),
            factor * (0.5 * speed * x.u_n + 4e-3 * a_n),
        )


class BillowingSleeve(ForceDensity):
    """The loose fabric forms folds on the concave side, which scoop water if this side leads.

    F_n = -rho C H |u_n| u_n/2 (1 + tanh(kappa u_n/(0.3/s)))/2    on the body
    """

    title = "loose sleeve that scoops water"
    size: Scalar = parameter(0.0, 0.0, 6.0, "-", WHY)

    def force(self, x):
        opened = (1.0 - x.in_tail) * 0.5 * (1.0 + jnp.tanh(x.kappa * x.u_n / 0.3))
        F_n = -500.0 * self.size * opened * x.height * jnp.abs(x.u_n) * x.u_n
        return jnp.zeros_like(F_n), F_n


class ReflectedWave(WaterMotion):
    """The wave from the robot's first stroke returns obliquely from the end of the tank.

    U_x = a g cos(2 pi 4 Hz (t - t_0)),    U_y = 0.4 a g sin(2 pi 4 Hz (t - t_0))
    g   = exp(-((t - t_0)/0.12 s)^2),      t_0 = 0.45 s
    """

    title = "wave that the end of the tank reflects"
    size: Scalar = parameter(0.0, 0.0, 0.3, "m/s", WHY)

    def velocity(self, t):
        packet = self.size * jnp.exp(-jnp.square((t - 0.45) / 0.12))
        angle = 2.0 * np.pi * 4.0 * (t - 0.45)
        return packet * jnp.cos(angle), 0.4 * packet * jnp.sin(angle)


class MultiplexerMemory(Instrument):
    """The converter reads both pressures in turn, and its capacitor keeps a part of the charge.

        front_read(i) = (1 - c) front(i) + c rear(i - 1)
        rear_read(i)  = (1 - c) rear(i) + c front(i)

    i counts the samples. The cause is a high source impedance of the pressure sensors.
    """

    title = "memory of the pressure sensors' multiplexer"
    sensors = ("pressure",)
    size: Scalar = parameter(0.0, 0.0, 0.2, "-", WHY)

    def read(self, true):
        front, rear = true.pressures
        last = jnp.concatenate([rear[:1], rear[:-1]])
        ghosts = jnp.stack([last - front, front - rear])
        return true._replace(pressures=true.pressures + self.size * ghosts)


class RubbingGuide(Instrument):
    """The linear guide of the thrust sensor rubs, so a part of the thrust does not reach it.

        thrust_read = F - c z,    0.05 N dz/dt = dF/dt - |dF/dt| z

    z is the state of the dry friction, from -1 to 1.
    """

    title = "guide of the thrust sensor that rubs"
    sensors = ("thrust",)
    size: Scalar = parameter(0.0, 0.0, 0.2, "N", WHY)

    def read(self, true):
        def body(z, change):
            sign = jnp.sign(change)
            z = sign + (z - sign) * jnp.exp(-jnp.abs(change) / 0.05)
            return z, z

        F = true.thrust
        _, z = jax.lax.scan(body, jnp.zeros_like(F[0]), jnp.diff(F))
        return true._replace(thrust=F - self.size * jnp.concatenate([jnp.zeros_like(z[:1]), z]))


class CreepingGlue(Instrument):
    """The glue under the recoil's strain gauge has become soft, so the gauge loses its strain.

    recoil_read = F - c y,    0.15 s dy/dt = F - y
    """

    title = "soft glue under the strain gauge of the recoil"
    sensors = ("recoil",)
    size: Scalar = parameter(0.0, 0.0, 0.8, "-", WHY)

    def read(self, true):
        F = true.recoil
        return true._replace(recoil=F - self.size * lagged(F, true.t, 0.15, jnp.zeros_like(F[0])))


class RollingShutter(Instrument):
    """The camera reads its lines in turn, so the time of exposure depends on the tip's position.

    tip_read(t) = tip(t - c tip(t))
    """

    title = "rolling shutter of the camera"
    sensors = ("tip",)
    size: Scalar = parameter(0.0, -0.35, 0.35, "s/m", WHY)

    def read(self, true):
        return true._replace(tip=delayed(true.tip, true.t, self.size * true.tip))


BLIND_EFFECTS = {
    "leaky_bulkhead": Whereabouts(PRESSURES, VALVES),
    "shared_supply": Whereabouts(PRESSURES, VALVES),
    "slow_clock": Whereabouts(PRESSURES, VALVES),
    "ringing_regulator": Whereabouts(PRESSURES, VALVES),
    "loosening_seam": Whereabouts(FORCES, MOMENT),
    "collapsing_tube": Whereabouts(FORCES, MOMENT),
    "thixotropic_sleeve": Whereabouts(FORCES, MOMENT),
    "gripping_sleeve": Whereabouts(FORCES, MOMENT),
    "creased_tail": Whereabouts(FORCES, MOMENT),
    "trailing_hose": Whereabouts(FORCES, WATER),
    "billowing_sleeve": Whereabouts(FORCES, WATER),
    "reflected_wave": Whereabouts(FORCES, WATER),
    "multiplexer_memory": Whereabouts(PRESSURES, ("Instrument",)),
    "rubbing_guide": Whereabouts(("thrust",), ("Instrument",)),
    "creeping_glue": Whereabouts(("recoil",), ("Instrument",)),
    "rolling_shutter": Whereabouts(("tip",), ("Instrument",)),
}
