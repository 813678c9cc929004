"""Effects that a laboratory could meet, written without reading the terms that the loop can learn.

The author had read the titles and docstrings of the library's effects, the code of three of them,
the base classes, the check of an effect, the waveforms, the fields of a section, the parameters of
the robot, the how-to on adding an effect, and the lists `unknown_effects`, `fresh_effects`,
`blind_effects`, `unseen_effects` and `novel_effects`. The author had not read the dictionary of
terms, its tests, the code that learns from it, the shared functions in
`slider_jax.effects.functions`, the explanations of the loop, the changelog or the history, and had
run no simulation. The shared function `delayed` is used as in `blind_effects`. From the docstring
of `unseen_effects`, the author knew that the shared functions contain bases of powers, drifts and
sines of a state. No law was chosen or left out with regard to this. Two laws were left out for
other reasons: a pause of the valves at each reversal is almost a delay of the valves, and friction
that decreases with the bending rate could make short waves of the body unstable.
"""

import jax
import jax.numpy as jnp
import numpy as np
from unknown_effects import FORCES, MOMENT, PRESSURES, VALVES, WATER, WHY, Whereabouts

from slider_jax.actuation.waveform import Segment, Waveform
from slider_jax.beam.parameters import Scalar
from slider_jax.effects import (
    BendingMoment,
    Command,
    Flow,
    ForceDensity,
    Instrument,
    WaterMotion,
    parameter,
)
from slider_jax.effects.body.internal_friction import dahl_state
from slider_jax.effects.functions import delayed


class StickySpool(Flow):
    """The spool of a valve sticks, and moves only if its error of position is large enough.

        dp/dt = q + c (z - e)/k,    e = p_set - p
        8 ms dz/dt = y - w y/(y^2 + w^2)^(1/2),    y = e - z,    w = 40 kPa

    q is dp/dt without the effect. z is the position of the spool, as the error that would open the
    valve as far. A free spool has z = e. c is the part of the flow that passes the sticky edge.
    """

    title = "spool of the valves that sticks"
    states = 1
    size: Scalar = parameter(0.0, 0.0, 1.0, "-", WHY)

    def rate(self, rate, x):
        return rate + self.size * (x.states[0] - (x.p_set - x.p)) / x.k

    def state_rates(self, rate, x):
        y = x.p_set - x.p - x.states[0]
        return ((y - 4e4 * y / jnp.sqrt(jnp.square(y) + 4e4**2)) / 8e-3)[None]


class FloodedHose(Flow):
    """Water has entered the hose of the rear chamber, and the first strokes blow the water out.

        dp_r/dt = q (1 - c exp(-z)),    dz/dt = ((q^2 + w^2)^(1/2) - w)/(2 MPa),    w = 100 kPa/s

    q is dp/dt without the water. z is the air that has moved through the hose since the start of
    the trial. c is the part of the flow that the water blocks at the start.
    """

    title = "water in the hose of the rear chamber"
    states = 1
    size: Scalar = parameter(0.0, 0.0, 0.95, "-", WHY)

    def rate(self, rate, x):
        return rate * (1.0 - self.size * x.rear * jnp.exp(-x.states[0]))

    def state_rates(self, rate, x):
        return ((jnp.sqrt(jnp.square(rate) + 1e5**2) - 1e5) / 2e6)[None]


class KinkingHose(Flow):
    """The hose of the rear chamber runs along the body, and kinks if the whole body bends far.

        dp_r/dt = q (1 - c S),    S = 1/(1 + exp(-(P - 180 kPa)/20 kPa)),    P = |p_f + p_r|

    q is dp/dt without the kink. p_f and p_r are the pressures of front and rear chamber. The angle
    of the whole body is about proportional to their sum. |p_f + p_r| is smoothed below 5 kPa.
    """

    title = "hose of the rear chamber that kinks in a bent body"
    size: Scalar = parameter(0.0, 0.0, 0.95, "-", WHY)

    def rate(self, rate, x):
        total = jnp.sqrt(jnp.square(x.p + x.p[::-1]) + 5e3**2)
        return rate * (1.0 - self.size * x.rear * jax.nn.sigmoid((total - 1.8e5) / 2e4))


class Relaxing(Waveform):
    """The set pressure wave(t) (1 - share (1 - exp(-t/0.4 s))).

    If `wave` is piecewise constant, a segment has an error of second order in the time step.
    """

    wave: Waveform
    share: Scalar

    def segment(self, t0, t1):
        x = self.wave.segment(t0, t1)
        start, middle, end = (
            1.0 - self.share * (1.0 - jnp.exp(-t / 0.4)) for t in (x.t0, x.t_break, x.t1)
        )
        return Segment(
            x.t0, x.t_break, x.t1, start * x.a0, middle * x.a1, middle * x.b0, end * x.b1
        )


class CreepingDiaphragm(Command):
    """The diaphragm of the rear chamber's regulator creeps under load, so its set point changes.

        p_set,valve(t) = p_set(t) (1 - c (1 - exp(-t/0.4 s)))    in the rear chamber

    t is the time since the start of the trial. The diaphragm recovers between two trials. The front
    chamber has a new regulator.
    """

    title = "regulator of the rear chamber that creeps"
    size: Scalar = parameter(0.0, -0.7, 0.7, "-", WHY, physical=(-1.0, 1.0))

    def command(self, wave, rear):
        return Relaxing(wave, self.size * rear)


class TautCable(BendingMoment):
    """The cable of a bend sensor lies slack along the rear half of the body, and becomes taut.

        M = EI (kappa + c w ln(1 + exp((kappa - 1.5/m)/w))),    w = 0.25/m,    s < 0.2 m

    The cable is on one side, so it is taut only for bending to one side. s is the distance from the
    tip of the tail. The cable ends within about 5 mm at s = 0.2 m, and does not lie on the tail.
    """

    title = "cable on one side of the body that becomes taut"
    size: Scalar = parameter(0.0, 0.0, 5.0, "-", WHY)

    def moment(self, x, memory, dt):
        taut = 0.25 * jax.nn.softplus((x.kappa - 1.5) / 0.25)
        at = (1.0 - x.in_tail) * jax.nn.sigmoid((0.2 - x.s) / 5e-3)
        return self.size * at * x.EI * taut, memory


class CapstanHoses(BendingMoment):
    """The hoses inside the bent body press on their guides and slip, like a rope on a capstan.

        M = EI (kappa + c K q),    K = (kappa^2 + w^2)^(1/2) - w,    w = 0.2/m
        0.5/m dq/dt = d(kappa)/dt - |d(kappa)/dt| q

    q is the state of the dry friction, from -1 to 1. The tension of the hoses presses them on the
    guides in proportion to the curvature, so there is no friction in a straight body. |d(kappa)/dt|
    is smoothed below 1 1/(m s).
    """

    title = "hoses that rub on their guides in a bent body"
    size: Scalar = parameter(0.0, 0.0, 1.0, "-", WHY)

    def moment(self, x, memory, dt):
        q = dahl_state(memory, x.kappa_t, dt, 0.5)
        pressed = jnp.sqrt(jnp.square(x.kappa) + 0.2**2) - 0.2
        return (1.0 - x.in_tail) * self.size * x.EI * pressed * q, q


class YieldingTail(BendingMoment):
    """The sheet of the tail is too thin for its load, and yields beyond an elastic curvature.

        M = EI (kappa - c q)    in the tail
        60 ms dq/dt = y g,    g = y^4/(y^4 + w^4),    y = kappa - q,    w = 2/m

    q is the curvature to which the sheet has yielded. The sheet hardly creeps while y is much
    smaller than w. g is computed with q at the start of a stage. The tail is straight at the start
    of a trial.
    """

    title = "tail that yields and keeps its bend"
    size: Scalar = parameter(0.0, 0.0, 0.9, "-", WHY)

    def moment(self, x, memory, dt):
        y4 = jnp.square(jnp.square(x.kappa - memory))
        step = dt / 0.06 * y4 / (y4 + 16.0)
        q = (memory + step * x.kappa) / (1.0 + step)
        return -self.size * x.in_tail * x.EI * q, q


class SwellingBody(ForceDensity):
    """Pressure makes the chambers swell, so the body is higher there and moves more water.

        F_n = -b (rho C H |u_n| u_n/2 + 2 rho pi H^2/4 a_n),    a_n = du_n/dt + omega u_tau
        b   = c P/(200 kPa),    P = (p^2 + w^2)^(1/2) - w,    w = 5 kPa

    p is the pressure in the chamber at s, and b the relative change of the height H. The drag is
    proportional to the height, with C = 2, and the added mass to the square of the height.
    """

    title = "chambers that swell and move more water"
    size: Scalar = parameter(0.0, 0.0, 2.0, "-", WHY)

    def force(self, x):
        b = self.size * (jnp.sqrt(jnp.square(x.pressure) + 5e3**2) - 5e3) / 2e5
        a_n = x.u_n_t + x.omega * x.u_tau
        drag = 1000.0 * x.height * jnp.abs(x.u_n) * x.u_n
        F_n = -b * (drag + 500.0 * np.pi * jnp.square(x.height) * a_n)
        return jnp.zeros_like(F_n), F_n


class RotationalLift(ForceDensity):
    """The tail turns while it moves sideways, and the turning adds lift (Kramer effect).

        F_n = -c rho H^2 v omega,    v = (u_n^2 + w^2)^(1/2) - w,    w = 2 cm/s,    on the tail

    The turning moves the point where the flow leaves the sheet, as on the wing of an insect. The
    force is proportional to the speed and to the turning rate omega.
    """

    title = "lift of the turning tail"
    size: Scalar = parameter(0.0, -4.0, 4.0, "-", WHY)

    def force(self, x):
        speed = jnp.sqrt(jnp.square(x.u_n) + 0.02**2) - 0.02
        F_n = -self.size * x.in_tail * 1000.0 * jnp.square(x.height) * speed * x.omega
        return jnp.zeros_like(F_n), F_n


class PassingEddy(WaterMotion):
    """An eddy, left in the tank from its refilling, drifts past the robot.

        (U_x, U_y) = c (1, a)/(1 + a^2),    a = (t - 0.5 s)/(0.15 s)

    This is the flow of a vortex that drifts along the tank and passes beside the robot at 0.5 s. a
    is the distance along the tank, divided by the distance of the vortex's path from the robot.
    """

    title = "eddy that drifts past the robot"
    size: Scalar = parameter(0.0, -0.5, 0.5, "m/s", WHY)

    def velocity(self, t):
        a = (t - 0.5) / 0.15
        U_x = self.size / (1.0 + jnp.square(a))
        return U_x, a * U_x


class StickyMembrane(Instrument):
    """Dirt sticks on the membrane of the front pressure sensor, so its reading has a hysteresis.

        front_read = p - c z,    40 kPa dz/dt = dp/dt - |dp/dt| z

    z is the state of the dry friction, from -1 to 1. The sensor of the rear chamber is clean. The
    pressure p, not the reading, bends the body.
    """

    title = "dirt on the membrane of the front pressure sensor"
    sensors = ("pressure",)
    size: Scalar = parameter(0.0, 0.0, 5e4, "Pa", WHY)

    def read(self, true):
        def stick(z, change):
            z = (z + change) / (1.0 + jnp.abs(change))
            return z, z

        p = true.pressures[0]
        _, z = jax.lax.scan(stick, jnp.zeros_like(p[0]), jnp.diff(p, prepend=p[:1]) / 4e4)
        return true._replace(pressures=true.pressures.at[0].add(-self.size * z))


class WanderingStamps(Instrument):
    """The computer that logs the thrust gets its time from a network, and its clock wanders.

        thrust_read(t) = thrust(t - c sin(2 pi 0.9 Hz t + 0.3))

    The network corrects the clock, first too far and then back. Recoil has another logger.
    """

    title = "time stamps of the thrust that wander"
    sensors = ("thrust",)
    size: Scalar = parameter(0.0, -0.04, 0.04, "s", WHY)

    def read(self, true):
        late = self.size * jnp.sin(2.0 * np.pi * 0.9 * true.t + 0.3)
        return true._replace(thrust=delayed(true.thrust, true.t, late))


class OverloadStop(Instrument):
    """The overload stop of the recoil sensor is too close, and carries a part of large forces.

        recoil_read = F - c w ln(1 + exp((F - 0.8 N)/w)),    w = 0.1 N

    The sensor touches the stop only at recoil of one sign. c is the stop's part of the recoil above
    0.8 N.
    """

    title = "overload stop of the recoil sensor"
    sensors = ("recoil",)
    size: Scalar = parameter(0.0, 0.0, 1.0, "-", WHY)

    def read(self, true):
        above = 0.1 * jax.nn.softplus((true.recoil - 0.8) / 0.1)
        return true._replace(recoil=true.recoil - self.size * above)


class LitEdge(Instrument):
    """A fast tip is a smear in the image, and the software finds the edge on the lamp's side.

        tip_read = tip + c ((v^2 + w^2)^(1/2) - w),    v = d(tip)/dt,    w = 5 cm/s

    The smear is as long as the path of the tip during the exposure, so c is half of the time of
    exposure. The sign of c is the side of the lamp. v is the difference of two samples, divided by
    the time between them.
    """

    title = "smeared image of the tip with one bright edge"
    sensors = ("tip",)
    size: Scalar = parameter(0.0, -0.04, 0.04, "s", WHY)

    def read(self, true):
        v = jnp.diff(true.tip, prepend=true.tip[:1]) / (true.t[1] - true.t[0])
        smear = jnp.sqrt(jnp.square(v) + 0.05**2) - 0.05
        return true._replace(tip=true.tip + self.size * smear)


FURTHER_EFFECTS = {
    "sticky_spool": Whereabouts(PRESSURES, VALVES),
    "flooded_hose": Whereabouts(PRESSURES, VALVES),
    "kinking_hose": Whereabouts(PRESSURES, VALVES),
    "creeping_diaphragm": Whereabouts(PRESSURES, VALVES),
    "taut_cable": Whereabouts(FORCES, MOMENT),
    "capstan_hoses": Whereabouts(FORCES, MOMENT),
    "yielding_tail": Whereabouts(FORCES, MOMENT),
    "swelling_body": Whereabouts(FORCES, WATER),
    "rotational_lift": Whereabouts(FORCES, WATER),
    "passing_eddy": Whereabouts(FORCES, WATER),
    "sticky_membrane": Whereabouts(("p_front",), ("Instrument",)),
    "wandering_stamps": Whereabouts(("thrust",), ("Instrument",)),
    "overload_stop": Whereabouts(("recoil",), ("Instrument",)),
    "lit_edge": Whereabouts(("tip",), ("Instrument",)),
}
