"""Fourteen effects that a workshop's robot and rig may have and that the library lacks.

The author read the library of effects with its base classes, its check, its loader and its shared
functions, the waveforms and the moment of the chambers, the beam, the channels, the README, the
first 150 lines of the glossary and the settings in docs/experiment.toml. The shared functions
contain the powers, corners and waves from which the terms of the dictionary are built, and the
glossary contains short definitions of verdicts and thresholds, so the author saw those. The author
read benchmarks/unknown_effects.py, and of benchmarks/everyday_effects.py the first 60 lines and the
last 25 lines, as an example of the format; the names there were known, and most laws were not. The
author did not open the folder of the dictionary, the code that searches for missing effects or that
learns a law, the other lists of effects, the explanations, the change log, the tests or any result.
The author ran no simulation. The effects come from textbooks, data sheets and general knowledge of
pneumatics, plastics, rubber, water and measurement technique. Constants without a source are the
author's assumptions.
"""

import math

import jax
import jax.numpy as jnp
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
from slider_jax.effects.base import last_sample
from slider_jax.effects.functions import lag_coefficients

DENSITY = 1000.0
"""Density rho [kg/m^3] of the water."""


class ShopQuickExhaust(Flow):
    """A quick exhaust valve at each chamber opens while the chamber is far above its set pressure.

        dp/dt = q (1 + size/(1 + exp((p_q - d)/w))),    d = |p| - sign(p) p_set

    q is dp/dt without the effect. p_q = 60 kPa is the difference at which the lip of the valve
    lifts, and w = 8 kPa. Filling is unchanged, apart from 0.06 % of size. Source: Festo, data sheet
    of the quick exhaust valves SE; Beater, P. (2007), Pneumatic Drives, Springer, ch. 5.
    """

    title = "quick exhaust valves at the chambers"
    size: Scalar = parameter(0.0, 0.0, 3.0, "-", WHY)

    def rate(self, rate, x):
        above = -x.side * (x.p_set - x.p)
        return rate * (1.0 + self.size * jax.nn.sigmoid((above - 60e3) / 8e3))


class ShopExhaustBackflow(Flow):
    """Air that leaves one chamber flows through the common exhaust port into the other chamber.

        d|p|/dt = q + size v/(1 + (p/p_b)^2)
        v       = max(-q_o, 0) |p_o|/(|p_o| + p_c)

    q is d|p|/dt without the effect, and the subscript o denotes the other chamber. v is the flow of
    the other chamber into the port. A chamber with a pressure above p_b = 60 kPa hardly receives
    air. p_c is 30 kPa. Source: SMC, catalogue of the valves SY, on check valves against the back
    pressure of a manifold.
    """

    title = "exhaust air that flows back through the manifold"
    size: Scalar = parameter(0.0, 0.0, 0.3, "-", WHY)

    def rate(self, rate, x):
        p = jnp.abs(x.p)
        leaving = jnp.maximum(-x.side * rate, 0.0) * p / (p + 30e3)
        share = 1.0 / (1.0 + jnp.square(x.p / 60e3))
        return rate + self.size * x.side * share * jnp.flip(leaving, axis=-1)


class ShopStickyRegulator(Flow):
    """Friction holds the diaphragm of the pressure regulator, so its set point has a hysteresis.

        dp/dt   = q - size z/k
        w dz/dt = dp/dt - ((dp/dt)^2 + r^2)^(1/2) z

    q is dp/dt without the effect. A rising pressure stops at p_set - size, and a falling pressure
    at p_set + size. w = 20 kPa, and r = 1 kPa/s only makes the corner smooth. Source: SMC, data
    sheet of the regulators ITV, on hysteresis; Dahl, P. R. (1976), Solid friction damping of
    mechanical vibrations, AIAA J. 14, 1675-1682.
    """

    title = "regulator with a sticky diaphragm"
    states = 1
    size: Scalar = parameter(0.0, 0.0, 40e3, "Pa", WHY)

    def rate(self, rate, x):
        return rate - self.size * x.states[0] / x.k

    def state_rates(self, rate, x):
        actual = self.rate(rate, x)
        z_t = (actual - jnp.sqrt(jnp.square(actual) + 1e6) * x.states[0]) / 20e3
        return z_t[None]


class _Pulsing(Waveform):
    """The set pressure (1 + `share` sin(2 pi 7 Hz t + 0.9)) wave; the sine is linear in a part."""

    wave: Waveform
    share: Scalar

    def segment(self, t0, t1):
        def factor(t):
            return 1.0 + self.share * jnp.sin(2.0 * math.pi * 7.0 * t + 0.9)

        x = self.wave.segment(t0, t1)
        start, middle, end = factor(x.t0), factor(x.t_break), factor(x.t1)
        return Segment(
            x.t0, x.t_break, x.t1, start * x.a0, middle * x.a1, middle * x.b0, end * x.b1
        )


class ShopPumpPulsation(Command):
    """The piston pump has no buffer tank, so its strokes of 7 Hz modulate the delivered pressure.

        p_set,valve(t) = p_set(t) (1 + size sin(2 pi 7 Hz t + 0.9))

    The pump starts with the trial. Source: Bloch, H. P. and Hoefner, J. J. (1996), Reciprocating
    Compressors, Gulf, on pulsation.
    """

    title = "pulsation of the pump"
    size: Scalar = parameter(0.0, 0.0, 0.4, "-", WHY)

    def command(self, wave, rear):
        return _Pulsing(wave, self.size)


class ShopRepairPatch(BendingMoment):
    """A glued patch over a repaired tear stiffens 40 mm of the body at the rear chamber.

        M = EI (1 + size g(s)) (kappa + alpha d(kappa)/dt)

    g is 1 for 0.13 m < s < 0.17 m and 0 elsewhere, with edges of 6 mm. alpha is the damping time of
    the body. Source: beams of two materials, Gere, J. M. and Timoshenko, S. P. (1997), Mechanics of
    Materials, 4th ed., ch. 6.
    """

    title = "repair patch on the body"
    segments = ("body",)
    size: Scalar = parameter(0.0, 0.0, 4.0, "-", WHY)

    def moment(self, x, memory, dt):
        patch = 0.5 * (jnp.tanh((x.s - 0.13) / 6e-3) - jnp.tanh((x.s - 0.17) / 6e-3))
        rigid = x.EI * (x.kappa + x.damping_time * x.kappa_t)
        return (1.0 - x.in_tail) * self.size * patch * rigid, memory


class ShopPowerCreep(BendingMoment):
    """A part of the body's rubber creeps at a rate that grows with the square of its stress.

        M = EI kappa + size q,    dq/dt = d(kappa)/dt - |q| q/(q_0 tau)

    q is the curvature that has not relaxed yet. A large q relaxes in a short time, and a small q
    in a long time. q_0 tau is 0.04 s/m. Each stage is solved in closed form. Source: power law of
    creep with the exponent 2, Findley, W. N., Lai, J. S. and Onaran, K. (1976), Creep and
    Relaxation of Nonlinear Viscoelastic Materials, North-Holland.
    """

    title = "rubber that creeps with the square of the stress"
    segments = ("body",)
    size: Scalar = parameter(0.0, 0.0, 0.03, "N m^2", WHY)

    def moment(self, x, memory, dt):
        free = memory + dt * x.kappa_t
        q = 2.0 * free / (1.0 + jnp.sqrt(1.0 + 4.0 * dt / 0.04 * jnp.abs(free)))
        return (1.0 - x.in_tail) * self.size * q, q


class ShopSofterSheet(BendingMoment):
    """The secant modulus of the tail's plastic sheet falls with the strain, without a memory.

        M = EI kappa (1 - size kappa^2/(kappa^2 + kappa_0^2))    in the tail

    kappa_0 = 3 1/m is the curvature at which half of the loss is reached. The bending stiffness of
    a strongly bent sheet approaches (1 - size) EI. Source: secant moduli in data sheets of
    plastics, Crawford, R. J. (1998), Plastics Engineering, 3rd ed., Butterworth-Heinemann, ch. 2.
    """

    title = "tail sheet that softens with the strain"
    segments = ("tail",)
    size: Scalar = parameter(0.0, 0.0, 0.8, "-", WHY)

    def moment(self, x, memory, dt):
        square = jnp.square(x.kappa)
        return -x.in_tail * self.size * x.EI * x.kappa * square / (square + 9.0), memory


class ShopMeterOut(ActingPressure):
    """A one-way throttle between sensor and chamber delays the outflow, but not the inflow.

        y_i = p_i                         while p_i rises above y_i
        size dy_i/dt = p_i - y_i          while p_i is below y_i
        p_act = y_left - y_right

    p_left = max(p, 0) and p_right = max(-p, 0) are the pressures at the sensors of the two sides.
    The model keeps only p_act - p, so the last outflow of one side is lost if the other side begins
    to empty earlier. Source: SMC, catalogue of the speed controllers AS, meter-out type; Beater, P.
    (2007), Pneumatic Drives, Springer, ch. 5.
    """

    title = "one-way throttle at the chambers"
    size: Scalar = parameter(0.0, 0.0, 0.08, "s", WHY)

    def act(self, p, memory, dt):
        y, before = memory
        e, m = lag_coefficients(self.size, dt)

        def kept(now, past, excess):
            left = e * excess - m * (now - past)
            return jnp.where((now < past + excess) & (left >= 0.0), left, 0.0)

        excess = y - before
        one = kept(jnp.maximum(p, 0.0), jnp.maximum(before, 0.0), jnp.maximum(excess, 0.0))
        two = kept(jnp.maximum(-p, 0.0), jnp.maximum(-before, 0.0), jnp.maximum(-excess, 0.0))
        y = p + one - two
        return y, jnp.stack([y, p])


class ShopProtrusions(ForceDensity):
    """Cable ties, hose clips and seams on the body have the same drag in all directions.

        (F_tau, F_n) = -rho size H |u| (u_tau, u_n)/2,    |u|^2 = u_tau^2 + u_n^2 + (1 mm/s)^2

    Small blunt parts see the whole speed, not only its component across the body. Source: Hoerner,
    S. F. (1965), Fluid-Dynamic Drag, ch. 5, on surface irregularities.
    """

    title = "drag of cable ties and clips on the body"
    resists_axially = True
    size: Scalar = parameter(0.0, 0.0, 1.0, "-", WHY)

    def force(self, x):
        speed = jnp.sqrt(jnp.square(x.u_tau) + jnp.square(x.u_n) + 1e-6)
        c = -0.5 * DENSITY * (1.0 - x.in_tail) * self.size * x.height * speed
        return c * x.u_tau, c * x.u_n


class ShopCaughtBubbles(ForceDensity):
    """Air bubbles stick to the robot when it is lowered into the tank, and its strokes remove them.

        F_n = size exp(-t/tau) rho pi H^2/4 du_n/dt

    The bubbles replace a part of the water that the robot accelerates. size is this part at the
    start of the trial, and tau = 0.8 s. The effect omits the bubbles' influence on the other terms
    of the reactive force. Source: density of a bubbly mixture, Brennen, C. E. (2005), Fundamentals
    of Multiphase Flow, Cambridge University Press, ch. 9.
    """

    title = "air bubbles on the robot"
    size: Scalar = parameter(0.0, 0.0, 0.6, "-", WHY)

    def force(self, x):
        part = self.size * jnp.exp(-jnp.expand_dims(x.t, -1) / 0.8)
        F_n = part * DENSITY * math.pi * jnp.square(x.height) / 4.0 * x.u_n_t
        return jnp.zeros_like(F_n), F_n


class ShopCarriageHunting(WaterMotion):
    """The servo of the carriage is badly tuned, so the carriage swings along x at the start.

        U_x = size exp(-t/tau) sin(2 pi f t)

    The law is the response of a weakly damped system of second order, with f = 2.3 Hz and tau =
    0.6 s. The swing is modelled as a water flow. The effect omits the inertia of the robot in the
    swinging carriage. Source: Franklin, G. F., Powell, J. D. and Emami-Naeini, A. (2010), Feedback
    Control of Dynamic Systems, 6th ed., Pearson, ch. 3.
    """

    title = "carriage that swings after its start"
    size: Scalar = parameter(0.0, -0.15, 0.15, "m/s", WHY)

    def velocity(self, t):
        U_x = self.size * jnp.exp(-t / 0.6) * jnp.sin(2.0 * math.pi * 2.3 * t)
        return U_x, jnp.zeros_like(U_x)


class ShopMultiplexerGhost(Instrument):
    """The converter samples the rear pressure too soon after the front pressure.

        p_rear,read = p_rear + size (p_front - p_rear)

    A multiplexer connects the sensors to one converter in turn. The voltage of the previous sensor
    has not decayed completely. The front pressure is sampled after a long pause, so its reading is
    right. Source: Horowitz, P. and Hill, W. (2015), The Art of Electronics, 3rd ed., Cambridge
    University Press, ch. 13.
    """

    title = "rest of the front pressure in the rear reading"
    sensors = ("pressure",)
    size: Scalar = parameter(0.0, 0.0, 0.3, "-", WHY)

    def read(self, true):
        ghost = self.size * (true.pressures[0] - true.pressures[1])
        return true._replace(pressures=true.pressures.at[1].add(ghost))


class ShopChargeDrain(Instrument):
    """The force sensor is piezoelectric, and its charge drains through the amplifier's resistor.

        F_read = F - y,    dy/dt = size (F - y),    y(0) = 0

    size is the inverse of the time constant of the amplifier. The reading of a constant force
    decays to zero. The trapezoidal rule integrates y. Source: piezoelectric transducers, Doebelin,
    E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill, ch. 4.
    """

    title = "piezoelectric force sensor that loses its charge"
    sensors = ("thrust", "recoil")
    size: Scalar = parameter(0.0, 0.0, 5.0, "1/s", WHY)

    def _drained(self, y, before, now, dt):
        a = 0.5 * self.size * dt
        return ((1.0 - a) * y + a * (before + now)) / (1.0 + a)

    def _series(self, force, t):
        def body(y, ends):
            y = self._drained(y, *ends, t[1] - t[0])
            return y, y

        first = jnp.zeros_like(force[0])
        _, rest = jax.lax.scan(body, first, (force[:-1], force[1:]))
        return force - jnp.concatenate([first[None], rest])

    def read(self, true):
        thrust, recoil = (self._series(force, true.t) for force in (true.thrust, true.recoil))
        return true._replace(thrust=thrust, recoil=recoil)

    def read_sample(self, true, read):
        def sample(force, given):
            y = force[-2] - given[-1]
            return force[-1] - self._drained(y, force[-2], force[-1], true.t[-1] - true.t[-2])

        thrust, recoil = sample(true.thrust, read.thrust), sample(true.recoil, read.recoil)
        return last_sample(true)._replace(thrust=thrust, recoil=recoil)


class ShopTracker(Instrument):
    """The camera's software predicts the tip with its last speed, and corrects the prediction.

        z_n = y_n + dt v_n,    y_(n+1) = z_n + A (x_(n+1) - z_n)
        v_(n+1) = v_n + B (x_(n+1) - z_n)/dt,    B = A^2/(2 - A)

    x is the true position, y the reading and v the speed in the alpha-beta filter, with alpha = A
    and beta = B. The filter's error at a constant acceleration a is size a with size = dt^2
    (1 - A)/B, which determines A. The code eliminates v. Source: Benedict, T. R. and Bordner, G. W.
    (1962), Synthesis of an optimal set of radar track-while-scan smoothing equations, IRE Trans.
    Autom. Control 7, 27-32.
    """

    title = "camera software that predicts the tip"
    sensors = ("tip",)
    size: Scalar = parameter(0.0, 0.0, 1e-3, "s^2", WHY)

    def _next(self, y, y_before, x_before, x, dt):
        A = 4.0 / (3.0 + jnp.sqrt(1.0 + 8.0 * self.size / dt**2))
        B = A**2 / (2.0 - A)
        return (2.0 - A - B) * y - (1.0 - A) * y_before + A * x + (B - A) * x_before

    def read(self, true):
        x, dt = true.tip, true.t[1] - true.t[0]

        def body(past, ends):
            y = self._next(*past, *ends, dt)
            return (y, past[0]), y

        _, rest = jax.lax.scan(body, (x[0], x[0]), (x[:-1], x[1:]))
        return true._replace(tip=jnp.concatenate([x[:1], rest]))

    def read_sample(self, true, read):
        y, y_before = read.tip[-1], read.tip[-2]
        tip = self._next(y, y_before, true.tip[-2], true.tip[-1], true.t[-1] - true.t[-2])
        return last_sample(true)._replace(tip=tip)


WORKSHOP_EFFECTS = {
    "shop_quick_exhaust": Whereabouts(PRESSURES, VALVES),
    "shop_exhaust_backflow": Whereabouts(PRESSURES, VALVES),
    "shop_sticky_regulator": Whereabouts(PRESSURES, VALVES),
    "shop_pump_pulsation": Whereabouts(PRESSURES, VALVES),
    "shop_repair_patch": Whereabouts(FORCES, MOMENT),
    "shop_power_creep": Whereabouts(FORCES, MOMENT),
    "shop_softer_sheet": Whereabouts(FORCES, MOMENT),
    "shop_meter_out": Whereabouts(FORCES, MOMENT),
    "shop_protrusions": Whereabouts(FORCES, WATER),
    "shop_caught_bubbles": Whereabouts(FORCES, WATER),
    "shop_carriage_hunting": Whereabouts(FORCES, WATER),
    "shop_multiplexer_ghost": Whereabouts(("p_rear",), ("Instrument",)),
    "shop_charge_drain": Whereabouts(("thrust", "recoil"), ("Instrument",)),
    "shop_tracker": Whereabouts(("tip",), ("Instrument",)),
}
