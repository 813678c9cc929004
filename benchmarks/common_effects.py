"""Effects that an experimenter would name first, and that the library lacks.

The author was asked for the most common effects of a laboratory, and did not know the lists
`unknown_effects`, `fresh_effects`, `blind_effects`, `unseen_effects`, `novel_effects` and
`further_effects`. The list may therefore contain effects of the other lists.

The author had read the library of effects, the base classes and the check of an effect, the
waveforms and pressure laws, the fields of a section, the set pressures, and lines about channels
and sensors that a text search showed. The author had not read the dictionary of terms, the
functions that effects share, the code that learns, the explanations or the tests, and had run no
simulation. After that, only the names of two classes that other lists use were changed.
"""

import math

import jax
import jax.numpy as jnp
from unknown_effects import FORCES, MOMENT, PRESSURES, VALVES, WATER, WHY, Whereabouts

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
from slider_jax.effects.base import last_sample
from slider_jax.effects.body.internal_friction import dahl_state

ATMOSPHERE = 101325.0
"""Atmospheric pressure p_a [Pa]."""
DENSITY = 1000.0
"""Density rho of the water [kg/m^3]."""


# Flow


class SlackBladder(Flow):
    """A flat, slack bladder takes up air before its walls are tight.

        dp/dt = q/(1 + c/(1 + (p/p_0)^2)),    p_0 = 15 kPa

    q is dp/dt without the effect. Near zero pressure, the bladder's volume grows with almost no
    pressure, so the pressure pauses there. Far above p_0, the bladder is tight. c is the additional
    compliance at zero pressure, divided by the compliance of the tight bladder.
    """

    title = "slack bladders that must unfold before the pressure rises"
    size: Scalar = parameter(0.0, 0.0, 4.0, "-", WHY)

    def rate(self, rate, x):
        return rate / (1.0 + self.size / (1.0 + jnp.square(x.p / 15e3)))


class SharedSupplyHose(Flow):
    """Both chambers fill through one narrow supply hose, so they slow each other down.

        dp_i/dt = q_i/(1 + c o_i S),    S = f_front + f_rear
        f = (g + (g^2 + w^2)^(1/2))/2,  o = (1 + g/(g^2 + w^2)^(1/2))/2,    w = 50 kPa/s

    q is dp/dt without the effect, and g is q with the sign of p, so that g > 0 if a chamber fills.
    S is the total air that the supply hose delivers. o is 1 for a chamber that fills, and 0 for a
    chamber that vents, because the vents do not use the supply hose.
    """

    title = "one narrow supply hose for both chambers"
    size: Scalar = parameter(0.0, 0.0, 2e-6, "s/Pa", WHY)

    def rate(self, rate, x):
        g = x.side * rate
        root = jnp.sqrt(jnp.square(g) + 5e4**2)
        total = jnp.sum(0.5 * (g + root), axis=-1, keepdims=True)
        return rate / (1.0 + self.size * 0.5 * (1.0 + g / root) * total)


class DenserAir(Flow):
    """Laminar flow of a gas in a long thin hose: dense air carries more mass.

        dp/dt = q (1 + c (|p| + max(p_set sign(p), 0))/(2 p_a))

    q is dp/dt without the effect. The mass flow of a laminar gas flow is proportional to the
    difference of the squared absolute pressures at the hose's ends, so to the pressure difference
    times the mean absolute pressure. c = 1 is this law. While a chamber vents, the outer end of the
    hose is at the atmospheric pressure p_a.
    """

    title = "laminar hoses that carry more air at high pressure"
    size: Scalar = parameter(0.0, 0.0, 1.5, "-", WHY)

    def rate(self, rate, x):
        ends = x.side * x.p + jnp.maximum(x.side * x.p_set, 0.0)
        return rate * (1.0 + self.size * ends / (2.0 * ATMOSPHERE))


class PinholeRearLeft(Flow):
    """A pinhole in the left rear chamber, through which the air flows turbulently.

        dp_r/dt = q - c (100 kPa)^(1/2) p_+/(p_+^2 + w^2)^(1/4),    p_+ = max(p_r, 0),  w = 5 kPa

    q is dp/dt without the effect. Above w, the leak is proportional to the square root of the
    pressure. The right chamber (p_r < 0) and the front chambers are tight.
    """

    title = "pinhole in the left rear chamber"
    size: Scalar = parameter(0.0, 0.0, 5.0, "1/s", WHY)

    def rate(self, rate, x):
        # The sign of p changes only where the solver splits its step.
        p = jnp.where(x.side > 0.0, x.p, 0.0)
        leak = math.sqrt(1e5) * p / (jnp.square(p) + 5e3**2) ** 0.25
        return rate - self.size * x.rear * leak


# ActingPressure


class RunIn(ActingPressure):
    """The actuators run in: the moment per pressure changes with the strokes of a trial.

        p_act = p (1 + c (1 - exp(-z/(2 MPa)))),    dz/dt = |dp/dt|

    z is the sum of all pressure changes since the start. One change from -150 to 150 kPa adds
    0.3 MPa. With a positive c, the first strokes soften the rubber of the actuators' walls, or the
    fibres settle, and the same pressure bends the body further. |dp| of a time step is smoothed
    below 10 Pa.
    """

    title = "the actuators run in during the first strokes"
    size: Scalar = parameter(0.0, -0.4, 0.6, "-", WHY)

    def act(self, p, memory, dt):
        z, before = memory
        z = z + jnp.sqrt(jnp.square(p - before) + 10.0**2) - 10.0
        return p * (1.0 - self.size * jnp.expm1(-z / 2e6)), jnp.stack([z, p])


# BendingMoment


class PressedFriction(BendingMoment):
    """Pressure presses bladder and sleeve together, so their dry friction grows with the pressure.

        M = EI kappa + c ((p^2 + w^2)^(1/2) - w) q,    w = 5 kPa
        kappa_c dq/dt = d(kappa)/dt - |d(kappa)/dt| q,    kappa_c = 0.5 1/m

    p is the pressure of the chamber at the cell. Without pressure, there is no friction. The
    friction of braided pneumatic muscles behaves in this way (Chou and Hannaford 1996).
    """

    title = "friction that grows with the pressure"
    segments = ("body",)
    size: Scalar = parameter(0.0, 0.0, 2e-7, "N m/Pa", WHY)

    def moment(self, x, memory, dt):
        q = dahl_state(memory, x.kappa_t, dt, 0.5)
        pressed = jnp.sqrt(jnp.square(x.pressure) + 5e3**2) - 5e3
        return self.size * pressed * q, q


class GrowingDamping(BendingMoment):
    """The viscous damping of body and tail grows with the curvature.

        M = EI (kappa + c kappa^2 d(kappa)/dt)

    Rubber that is strained more damps more. This is the usual nonlinear damping of soft structures
    at large amplitudes (Amabili 2018). A straight body does not feel it.
    """

    title = "damping that grows with the curvature"
    segments = ("body", "tail")
    size: Scalar = parameter(0.0, 0.0, 5e-3, "m^2 s", WHY)

    def moment(self, x, memory, dt):
        return self.size * x.EI * jnp.square(x.kappa) * x.kappa_t, memory


class TouchingRibs(BendingMoment):
    """The ribs or pleats on one side of the body touch when the body bends far to this side.

        M = EI (kappa + c (r(kappa - kappa_1) - r(-kappa_1)))
        r(x) = (x + (x^2 + w^2)^(1/2))/2,    kappa_1 = 0.8 1/m,  w = 0.3 1/m

    Beyond the curvature kappa_1, the pressed ribs are an additional spring of c EI. Bending to the
    other side opens the ribs.
    """

    title = "ribs on one side that touch"
    segments = ("body",)
    size: Scalar = parameter(0.0, 0.0, 4.0, "-", WHY)

    def moment(self, x, memory, dt):
        def ramp(y):
            return 0.5 * (y + jnp.sqrt(jnp.square(y) + 0.3**2))

        pressed = ramp(x.kappa - 0.8) - ramp(jnp.asarray(-0.8))
        return (1.0 - x.in_tail) * self.size * x.EI * pressed, memory


# ForceDensity and WaterMotion


class RubbingTail(ForceDensity):
    """The tail sags and rubs on the floor of the tank, with dry friction.

        (F_tau, F_n) = -c (V_tau, V_n)/(V_tau^2 + V_n^2 + w^2)^(1/2)  in the tail,    w = 2 cm/s

    V is the velocity relative to the tank. c is the friction coefficient times the weight per
    length that the floor carries.
    """

    title = "the tail rubs on the floor of the tank"
    size: Scalar = parameter(0.0, 0.0, 4.0, "N/m", WHY)

    def force(self, x):
        speed = jnp.sqrt(jnp.square(x.V_tau) + jnp.square(x.V_n) + 0.02**2)
        share = self.size * x.in_tail / speed
        return -share * x.V_tau, -share * x.V_n


class TaperedBody(ForceDensity):
    """The crossflow also pushes a tapered body along its axis.

        F_tau = rho C H u_n^2/2  on the body

    The sides of a body that becomes thinner towards the tail are inclined to the axis, so the
    pressure of the crossflow has a part along the axis. It has the same direction in both strokes.
    The tail is a sheet of uniform thickness and has no such force.
    """

    title = "crossflow that pushes a tapered body along its axis"
    size: Scalar = parameter(0.0, -0.6, 0.6, "-", WHY)

    def force(self, x):
        area = (1.0 - x.in_tail) * x.height
        F_tau = 0.5 * DENSITY * self.size * area * jnp.square(x.u_n)
        return F_tau, jnp.zeros_like(F_tau)


class YieldingEdges(ForceDensity):
    """The soft edges of the tail fold back in fast flow, so their drag stops growing.

        F_n = -rho C H |u_n| u_n/(2 (1 + (u_n/U)^2))  on the tail,    U = 0.2 m/s

    At speeds below U, the edges are straight and have the usual quadratic drag with the coefficient
    C. Above U, they fold back, as leaves and other flexible plates do (Vogel's reconfiguration).
    """

    title = "edges of the tail that fold back in fast flow"
    size: Scalar = parameter(0.0, 0.0, 6.0, "-", WHY)

    def force(self, x):
        u = x.u_n
        square = jnp.abs(u) * u / (1.0 + jnp.square(u / 0.2))
        F_n = -0.5 * DENSITY * self.size * x.in_tail * x.height * square
        return jnp.zeros_like(F_n), F_n


class DyingSlosh(WaterMotion):
    """The water still sloshes across the tank when a trial starts, and comes to rest.

        U_y = c exp(-t/tau) sin(2 pi f t),    tau = 2 s,  f = 1.1 Hz

    The experimenter has touched the robot, or the previous trial has just ended. 1.1 Hz is the
    lowest sloshing frequency across a tank about 0.6 m wide and 0.3 m deep.
    """

    title = "water that still sloshes across the tank at the start"
    size: Scalar = parameter(0.0, -0.1, 0.1, "m/s", WHY)

    def velocity(self, t):
        U_y = self.size * jnp.exp(-t / 2.0) * jnp.sin(2.0 * math.pi * 1.1 * t)
        return jnp.zeros_like(U_y), U_y


# Instrument


class SharedCable(Instrument):
    """The signal of the front pressure couples into the wire of the rear pressure.

        p_rear_read = p_rear + c p_front

    Both sensors share a ground wire, or the converter reads the rear sensor after the front sensor
    and keeps a part of the charge.
    """

    title = "the front pressure couples into the rear pressure's reading"
    sensors = ("pressure",)
    size: Scalar = parameter(0.0, -0.15, 0.15, "-", WHY)

    def read(self, true):
        return true._replace(pressures=true.pressures.at[1].add(self.size * true.pressures[0]))


class GuideFriction(Instrument):
    """The guide of the thrust sensor rubs, and carries a part of the thrust.

        thrust_read = thrust - c v/(v^2 + w^2)^(1/2),    v = d(thrust)/dt,  w = 0.2 N/s

    The sensor yields in proportion to the thrust. The guide's dry friction opposes this motion, so
    its sign is the sign of v. v is a backward difference of two samples.
    """

    title = "dry friction in the guide of the thrust sensor"
    sensors = ("thrust",)
    size: Scalar = parameter(0.0, 0.0, 0.05, "N", WHY)

    def read(self, true):
        v = jnp.diff(true.thrust) / jnp.diff(true.t)
        v = jnp.concatenate([jnp.zeros_like(v[:1]), v])
        rubbing = v / jnp.sqrt(jnp.square(v) + 0.2**2)
        return true._replace(thrust=true.thrust - self.size * rubbing)


class ChargeLeak(Instrument):
    """The recoil is measured with a piezoelectric sensor, whose charge leaks away.

        d(recoil_read)/dt = d(recoil)/dt - r recoil_read

    The reading of a constant force decays with the time constant 1/r. The initial reading is the
    force at the start. The trapezoidal rule solves the equation.
    """

    title = "the charge of the recoil's piezoelectric sensor leaks away"
    sensors = ("recoil",)
    size: Scalar = parameter(0.0, 0.0, 4.0, "1/s", WHY)

    def _next(self, read, change, dt):
        half = 0.5 * self.size * dt
        return ((1.0 - half) * read + change) / (1.0 + half)

    def read(self, true):
        def step(read, inputs):
            read = self._next(read, *inputs)
            return read, read

        first = jnp.asarray(true.recoil)[0]
        _, rest = jax.lax.scan(step, first, (jnp.diff(true.recoil), jnp.diff(true.t)))
        return true._replace(recoil=jnp.concatenate([first[None], rest]))

    def read_sample(self, true, read):
        change, dt = true.recoil[-1] - true.recoil[-2], true.t[-1] - true.t[-2]
        return last_sample(true)._replace(recoil=self._next(read.recoil[-1], change, dt))


class KeystoneCamera(Instrument):
    """The camera looks at the water surface at an angle, so the near side looks larger.

        tip_read = tip/(1 - c tip)

    c is the tangent of the camera's angle divided by its distance. This is the keystone of a
    perspective view, after the scale has been set at the middle of the picture.
    """

    title = "keystone of a tilted camera"
    sensors = ("tip",)
    size: Scalar = parameter(0.0, -3.0, 3.0, "1/m", WHY)

    def read(self, true):
        return true._replace(tip=true.tip / (1.0 - self.size * true.tip))


COMMON_EFFECTS = {
    "slack_bladder": Whereabouts(PRESSURES, VALVES),
    "shared_supply_hose": Whereabouts(PRESSURES, VALVES),
    "denser_air": Whereabouts(PRESSURES, VALVES),
    "pinhole_rear_left": Whereabouts(PRESSURES, VALVES),
    "run_in": Whereabouts(FORCES, MOMENT),
    "pressed_friction": Whereabouts(FORCES, MOMENT),
    "growing_damping": Whereabouts(FORCES, MOMENT),
    "touching_ribs": Whereabouts(FORCES, MOMENT),
    "rubbing_tail": Whereabouts(FORCES, WATER),
    "tapered_body": Whereabouts(FORCES, WATER),
    "yielding_edges": Whereabouts(FORCES, WATER),
    "dying_slosh": Whereabouts(FORCES, WATER),
    "shared_cable": Whereabouts(("p_rear",), ("Instrument",)),
    "guide_friction": Whereabouts(("thrust",), ("Instrument",)),
    "charge_leak": Whereabouts(("recoil",), ("Instrument",)),
    "keystone_camera": Whereabouts(("tip",), ("Instrument",)),
}
