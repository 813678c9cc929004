"""Sixteen effects that a real laboratory's robot may have and that the library lacks.

The author read the library of effects, the base classes and the check of effects, the waveforms,
the beam's equations, the computation of the pressures, the sensors' quantities, the table of the
experiment's settings and the README. The author did not read the code that searches for missing
effects or that learns a law, and no earlier list of effects, no result, no test and no document
about them. The author ran no simulation. The effects come from general knowledge of pneumatics,
soft actuators, rubber, water and measurement technique.
"""

import math

import jax.numpy as jnp
from unknown_effects import FORCES, MOMENT, PRESSURES, VALVES, WATER, WHY, Whereabouts

from slider_jax.actuation.waveform import Delayed, Segment, Waveform
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

ATMOSPHERE = 101325.0
"""Atmospheric pressure p_a [Pa]."""
DENSITY = 1000.0
"""Density rho [kg/m^3] of the water."""


def _size(x, width):
    """Returns |x|, smoothed to (x^2 + width^2)^(1/2) - width."""
    return jnp.sqrt(jnp.square(x) + width**2) - width


def _slope(x, t):
    """Returns dx/dt at each sample, from this sample and the sample before; 0 at the first."""
    if x.shape[0] < 2:
        return jnp.zeros_like(x)
    return jnp.concatenate([jnp.zeros_like(x[:1]), jnp.diff(x) / jnp.diff(t)])


class LabSaggingSupply(Flow):
    """Both chambers fill from one small buffer tank, whose pressure sags and then recovers.

        dp/dt = q/(1 + c z)    while |p| increases
        tau dz/dt = (f_front + f_rear)/(1 MPa/s) - z,    tau = 0.3 s

    q is dp/dt without the effect, and f the part of |q| that fills a chamber. z is the recent
    consumption of both chambers. Venting is unchanged. Source: charge and discharge of a volume,
    Beater, P. (2007), Pneumatic Drives, Springer.
    """

    title = "common supply whose pressure sags while the chambers fill"
    states = 1
    size: Scalar = parameter(0.0, 0.0, 1.0, "-", WHY)

    def rate(self, rate, x):
        return jnp.where(x.filling, rate / (1.0 + self.size * x.states[0]), rate)

    def state_rates(self, rate, x):
        filled = 0.5 * (x.side * rate + _size(rate, 2e4))
        return ((jnp.sum(filled) / 1e6 - x.states[0]) / 0.3)[None]


class LabLeakyPartition(Flow):
    """Air leaks between the front chamber and the rear chamber, through the wall or the manifold.

        dp_front/dt = q_front + c (p_rear - p_front)
        dp_rear/dt  = q_rear  + c (p_front - p_rear)

    q is dp/dt without the effect. Source: laminar leak between two volumes, Andersen, B. W. (1967),
    The analysis and design of pneumatic systems, Wiley.
    """

    title = "leak between front and rear chamber"
    size: Scalar = parameter(0.0, 0.0, 3.0, "1/s", WHY)

    def rate(self, rate, x):
        return rate + self.size * (x.p[::-1] - x.p)


class LabPinchedHose(Flow):
    """The rear chamber's hose runs past the front chamber, which pinches the hose as it bends.

        dp_rear/dt = q_rear/(1 + c (p_front/100 kPa)^2)

    q is dp/dt without the effect. The front chamber is unchanged. Source: flow through a hose whose
    cross-section shrinks, White, F. M. (2011), Fluid Mechanics, 7th ed., McGraw-Hill, ch. 6.
    """

    title = "rear hose that the front chamber pinches"
    size: Scalar = parameter(0.0, 0.0, 2.0, "-", WHY)

    def rate(self, rate, x):
        return rate / (1.0 + self.size * x.rear * jnp.square(x.p[0] / 1e5))


class LabLaminarHose(Flow):
    """Compressible laminar flow through a long hose: the flow grows with the mean pressure.

        dp/dt = q (1 + c m/p_a),    m = (|p| + max(sign(p) p_set, 0))/2

    q is dp/dt without the effect, and m the mean of the gauge pressures at both ends of the hose.
    For c = 1, the mass flow is proportional to the difference of the squared absolute pressures.
    Source: law of Hagen and Poiseuille for a gas, Andersen, B. W. (1967), The analysis and design
    of pneumatic systems, Wiley.
    """

    title = "compressible laminar flow through the hoses"
    size: Scalar = parameter(0.0, 0.0, 1.5, "-", WHY)

    def rate(self, rate, x):
        wanted = 0.5 * (x.side * x.p_set + _size(x.p_set, 5e3))
        mean = 0.5 * (_size(x.p, 5e3) + wanted)
        return rate * (1.0 + self.size * mean / ATMOSPHERE)


class _LateRise(Waveform):
    """The smaller one of `wave` and `wave` delayed by `delay` [s]: only rising edges are late."""

    wave: Waveform
    delay: Scalar

    def segment(self, t0, t1):
        now = self.wave.segment(t0, t1)
        late = Delayed(self.wave, self.delay).segment(t0, t1)
        falls = now.b0 < now.a1
        rises = ~falls & (late.b0 > late.a1)
        # An edge at t0 belongs to this segment, but the value before the edge does not count.
        now_first = jnp.where(~falls & (now.t_break <= t0), now.b0, now.a0)
        first = jnp.minimum(jnp.where(rises, now.b0, now_first), late.a0)
        last = jnp.minimum(now.b1, late.b1)
        t_break = jnp.where(falls, now.t_break, jnp.where(rises, late.t_break, t1))
        return Segment(t0, t_break, t1, first, jnp.where(falls | rises, first, last), last, last)


class LabSlowSwitchOn(Command):
    """The valves to the left need longer to switch than the valves to the right.

        p_set,valve(t) = min(p_set(t), p_set(t - d))

    Rising edges of the set pressure are late by d, and falling edges are on time, so the positive
    half of a stride is too short. Source: data sheets of solenoid valves, which state different
    times for switching on and for switching off.
    """

    title = "valves that switch later to one side"
    size: Scalar = parameter(0.0, 0.0, 0.04, "s", WHY)

    def command(self, wave, rear):
        return _LateRise(wave, self.size)


class LabConditioning(ActingPressure):
    """The first strokes after a rest make the actuators softer, so they bend more.

        p_act = p (1 + c (1 - exp(-z/z_0))),    dz/dt = |dp/dt|,    z_0 = 1.5 MPa

    z is the distance that the pressure of a chamber has travelled since the start of the trial.
    |dp/dt| is smoothed below 50 kPa/s. Source: conditioning of rubber by cycles, Gent, A. N.
    (2012), Engineering with Rubber, 3rd ed., Hanser.
    """

    title = "actuators that the first strokes condition"
    size: Scalar = parameter(0.0, 0.0, 0.6, "-", WHY)

    def act(self, p, memory, dt):
        travelled, before = memory
        travelled = travelled + _size(p - before, 5e4 * dt)
        return p * (1.0 - self.size * jnp.expm1(-travelled / 1.5e6)), jnp.stack([travelled, p])


class LabPressedSleeve(BendingMoment):
    """The pressure presses the bladders on their sleeve, so the friction grows with the pressure.

        M = EI kappa + c |p| q,    kappa_c dq/dt = d(kappa)/dt - |d(kappa)/dt| q

    p is the pressure of the chamber at the position s, and kappa_c is 0.3 1/m. Source: friction of
    McKibben muscles, Chou, C.-P. and Hannaford, B. (1996), Measurement and modeling of McKibben
    pneumatic artificial muscles, IEEE Trans. Robot. Autom. 12, 90-102.
    """

    title = "dry friction that grows with the pressure"
    segments = ("body",)
    size: Scalar = parameter(0.0, 0.0, 2e-7, "N m/Pa", WHY)

    def moment(self, x, memory, dt):
        q = dahl_state(memory, x.kappa_t, dt, 0.3)
        return (1.0 - x.in_tail) * self.size * _size(x.pressure, 5e3) * q, q


class LabPayneSoftening(BendingMoment):
    """Filled rubber is softer while it moves with a large amplitude, and recovers afterwards.

        M = EI kappa (1 - c q/(1 + q)),    tau dq/dt = (kappa/kappa_0)^2 - q

    kappa_0 is 1.5 1/m, and tau is 0.3 s. Source: Payne, A. R. (1962), The dynamic properties of
    carbon black-loaded natural rubber vulcanizates, J. Appl. Polym. Sci. 6, 57-63.
    """

    title = "rubber that is softer at large amplitudes"
    segments = ("body",)
    size: Scalar = parameter(0.0, 0.0, 0.8, "-", WHY)

    def moment(self, x, memory, dt):
        q = (memory + dt / 0.3 * jnp.square(x.kappa / 1.5)) / (1.0 + dt / 0.3)
        return -(1.0 - x.in_tail) * self.size * x.EI * x.kappa * q / (1.0 + q), q


class LabFoldFilm(BendingMoment):
    """Water is squeezed out of the closing folds of the body, so the damping grows with bending.

        M = EI (kappa + c (kappa/kappa_0)^2 d(kappa)/dt),    kappa_0 = 2 1/m

    Source: nonlinear damping, Nayfeh, A. H. and Mook, D. T. (1979), Nonlinear Oscillations, Wiley.
    """

    title = "damping that grows with the curvature"
    segments = ("body",)
    size: Scalar = parameter(0.0, 0.0, 0.03, "s", WHY)

    def moment(self, x, memory, dt):
        damping = self.size * jnp.square(x.kappa / 2.0) * x.kappa_t
        return (1.0 - x.in_tail) * x.EI * damping, memory


class LabStillWaterDrag(ForceDensity):
    """The first strokes act on water at rest; later, the wake moves with the body.

        F_n = -rho c H |u_n| u_n/2 exp(-t/tau),    tau = 0.6 s

    t is the time since the start of the trial. Source: drag of plates that start to move, Sarpkaya,
    T. (1966), Separated flow about lifting bodies and impulsive flow about cylinders, AIAA J. 4.
    """

    title = "larger drag of the first strokes"
    size: Scalar = parameter(0.0, 0.0, 6.0, "-", WHY)

    def force(self, x):
        drag = 0.5 * DENSITY * self.size * x.height * jnp.exp(-x.t / 0.6)
        F_n = -drag * _size(x.u_n, 0.01) * x.u_n
        return jnp.zeros_like(F_n), F_n


class LabTrailingEdge(ForceDensity):
    """The vortices that leave the tail's edge change the pressure at the tip.

        F_tau = -c m_A u_n^2/2 delta(s),    m_A = pi rho H^2/4

    The force acts in the cell at the tip. Slender-body theory supposes c = 0. Source: Lighthill, M.
    J. (1971), Large-amplitude elongated-body theory of fish locomotion, Proc. R. Soc. B 179.
    """

    title = "pressure at the trailing edge of the tail"
    segments = ("tail",)
    size: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY)

    def force(self, x):
        at_tip = jnp.where(x.s == x.s[0], 1.0 / x.ds, 0.0)
        m_A = math.pi * DENSITY * jnp.square(x.height) / 4.0
        F_tau = -0.5 * self.size * m_A * jnp.square(x.u_n) * at_tip
        return F_tau, jnp.zeros_like(F_tau)


class LabSurfaceWaves(ForceDensity):
    """The body moves close below the surface and makes waves, which carry energy away.

        F_n = -rho c H |u_n| u_n/2 Fr^2/(1 + Fr^2),    Fr^2 = u_n^2/(g d),    d = 3 cm

    Fr is the Froude number of the depth d. Source: wave resistance, Newman, J. N. (1977), Marine
    Hydrodynamics, MIT Press, ch. 6; Hoerner, S. F. (1965), Fluid-Dynamic Drag, ch. 11.
    """

    title = "drag of the waves at the surface"
    size: Scalar = parameter(0.0, 0.0, 8.0, "-", WHY)

    def force(self, x):
        square = jnp.square(x.u_n)
        share = square / (9.81 * 0.03 + square)
        F_n = -0.5 * DENSITY * self.size * x.height * _size(x.u_n, 0.01) * x.u_n * share
        return jnp.zeros_like(F_n), F_n


class LabRestlessWater(WaterMotion):
    """The water still flows across the tank from the trial before, and comes to rest.

        U_y = c exp(-t/tau),    tau = 1 s

    t is the time since the start of the trial. Source: decay of eddies, Batchelor, G. K. (1967), An
    Introduction to Fluid Dynamics, Cambridge University Press.
    """

    title = "water that is not yet at rest"
    size: Scalar = parameter(0.0, -0.15, 0.15, "m/s", WHY)

    def velocity(self, t):
        U_y = self.size * jnp.exp(-t)
        return jnp.zeros_like(U_y), U_y


class LabHoseDrop(Instrument):
    """The rear pressure sensor is at the valve, and fittings cause a turbulent pressure drop.

        p_rear,read = p_rear + c |dp_rear/dt| dp_rear/dt

    The flow is proportional to dp/dt. |dp/dt| is smoothed below 100 kPa/s. Source: minor losses,
    White, F. M. (2011), Fluid Mechanics, 7th ed., McGraw-Hill, ch. 6.
    """

    title = "pressure drop between the rear sensor and its chamber"
    sensors = ("pressure",)
    size: Scalar = parameter(0.0, 0.0, 8e-9, "s^2/Pa", WHY)

    def read(self, true):
        slope = _slope(true.pressures[1], true.t)
        drop = self.size * _size(slope, 1e5) * slope
        return true._replace(pressures=true.pressures.at[1].add(drop))


class LabTiltingStrut(Instrument):
    """The recoil bends the strut of the force sensor, and the tilted sensor reads a part of it.

        thrust_read = thrust + c recoil^2

    The angle of the tilt is c recoil. Source: cross-sensitivity of a multi-component balance,
    Doebelin, E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill, ch. 5.
    """

    title = "thrust sensor that the recoil tilts"
    sensors = ("thrust",)
    size: Scalar = parameter(0.0, -0.3, 0.3, "1/N", WHY)

    def read(self, true):
        return true._replace(thrust=true.thrust + self.size * jnp.square(true.recoil))


class LabRollingShutter(Instrument):
    """The camera reads its rows one after another, so the time of a reading depends on the place.

        tip_read = tip + c tip d(tip)/dt

    c is the time between two rows divided by their distance in the tank. Source: data sheets of
    image sensors with a rolling shutter.
    """

    title = "rolling shutter of the camera"
    sensors = ("tip",)
    size: Scalar = parameter(0.0, -0.3, 0.3, "s/m", WHY)

    def read(self, true):
        slope = _slope(true.tip, true.t)
        return true._replace(tip=true.tip + self.size * true.tip * slope)


EVERYDAY_EFFECTS = {
    "lab_sagging_supply": Whereabouts(PRESSURES, VALVES),
    "lab_leaky_partition": Whereabouts(PRESSURES, VALVES),
    "lab_pinched_hose": Whereabouts(PRESSURES, VALVES),
    "lab_laminar_hose": Whereabouts(PRESSURES, VALVES),
    "lab_slow_switch_on": Whereabouts(PRESSURES, VALVES),
    "lab_conditioning": Whereabouts(FORCES, MOMENT),
    "lab_pressed_sleeve": Whereabouts(FORCES, MOMENT),
    "lab_payne_softening": Whereabouts(FORCES, MOMENT),
    "lab_fold_film": Whereabouts(FORCES, MOMENT),
    "lab_still_water_drag": Whereabouts(FORCES, WATER),
    "lab_trailing_edge": Whereabouts(FORCES, WATER),
    "lab_surface_waves": Whereabouts(FORCES, WATER),
    "lab_restless_water": Whereabouts(FORCES, WATER),
    "lab_hose_drop": Whereabouts(("p_rear",), ("Instrument",)),
    "lab_tilting_strut": Whereabouts(("thrust",), ("Instrument",)),
    "lab_rolling_shutter": Whereabouts(("tip",), ("Instrument",)),
}
