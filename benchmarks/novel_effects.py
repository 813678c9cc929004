"""Effects that a laboratory could meet, written without reading the terms that the loop can learn.

The author had read the titles and docstrings of the library's effects, the code of five of them,
the base classes, the check of an effect, the waveforms, the parameters of the robot, the how-to on
adding an effect, parts of the glossary, and the lists `unknown_effects`, `fresh_effects`,
`blind_effects` and `unseen_effects`. The author had not read the dictionary of terms, its tests,
the code that learns from it, the shared functions in `slider_jax.effects.functions`, the
explanations of the loop, the changelog or the history, and had run no simulation. From the
docstring of `unseen_effects`, the author knew that the shared functions contain bases of powers,
drifts and sines of a state. No law was chosen or left out with regard to this.
"""

import jax
import jax.numpy as jnp
import numpy as np
from unknown_effects import FORCES, MOMENT, PRESSURES, VALVES, WATER, WHY, Whereabouts

from slider_jax.actuation.waveform import Delayed, Segment, Waveform
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


class IntegralAction(Flow):
    """The pressure regulator also has an integral part, which makes the pressure overshoot.

        dp/dt = q + c z,    dz/dt = p_set - p

    q is dp/dt without the integral part, and z the integral of the error since the start of the
    trial. The integral is not limited.
    """

    title = "integral part of the pressure regulator"
    states = 1
    size: Scalar = parameter(0.0, 0.0, 100.0, "1/s^2", WHY)

    def rate(self, rate, x):
        return rate + self.size * x.states[0]

    def state_rates(self, rate, x):
        return (x.p_set - x.p)[None]


class CommonGround(Flow):
    """The currents of all valves flow through one thin ground wire and lower the set voltages.

        dp/dt = (p_set - c (E_f + E_r) - p)/k,    E = (e^2 + w^2)^(1/2) - w,    e = p_set - p

    E_f and E_r are the smoothed |e| of front and rear chamber, with w = 5 kPa. The current of a
    valve is proportional to E. The voltage on the wire has the same sign for both sides.
    """

    title = "common ground wire of the valves"
    size: Scalar = parameter(0.0, 0.0, 0.3, "-", WHY)

    def rate(self, rate, x):
        current = jnp.sqrt(jnp.square(x.p_set - x.p) + 5e3**2) - 5e3
        return rate - self.size * (current + current[::-1]) / x.k


class Prolonged(Waveform):
    """The larger one of the set pressures wave(t) and wave(t - delay).

    Segments are exact if `wave` is a square wave and its half period is longer than the delay and
    a step, except in the first step of a trial.
    """

    wave: Waveform
    delay: Scalar

    def segment(self, t0, t1):
        now = self.wave.segment(t0, t1)
        late = Delayed(self.wave, self.delay).segment(t0, t1)
        t_break = jnp.where(now.b0 > now.a1, now.t_break, late.t_break)
        ends = (
            jnp.maximum(getattr(now, end), getattr(late, end)) for end in ("a0", "a1", "b0", "b1")
        )
        return Segment(t0, t_break, t1, *ends)


class LateRelease(Command):
    """The flyback diode of the left valves keeps the current in the coils, which release late.

        p_set,valve(t) = max(p_set(t), p_set(t - c))

    The valves close their ports later by the time c, but open them without a delay. The right
    valves have a faster circuit. p_set is zero before the trial.
    """

    title = "left valves that release late"
    size: Scalar = parameter(0.0, 0.0, 0.06, "s", WHY)

    def command(self, wave, rear):
        return Prolonged(wave, self.size)


class MullinsSleeve(BendingMoment):
    """Stretched rubber is softer below its largest former stretch (Mullins effect).

        M = EI kappa (1 - c tanh((q - |kappa|)/(1/m))),    10 ms dq/dt = max(|kappa| - q, 0)

    q is the largest former curvature at a section of the body. The time of 10 ms makes the law
    smooth. The rubber recovers between two trials.
    """

    title = "rubber that the first strokes soften"
    size: Scalar = parameter(0.0, 0.0, 0.8, "-", WHY)

    def moment(self, x, memory, dt):
        size = jnp.abs(x.kappa)
        q = memory + dt / (dt + 0.01) * jnp.maximum(size - memory, 0.0)
        return -(1.0 - x.in_tail) * self.size * x.EI * x.kappa * jnp.tanh(q - size), q


class FlatteningChambers(BendingMoment):
    """Bending flattens the section of a chamber, so its pressure has a smaller lever arm.

        M = EI kappa + c K_Q p kappa^2/(kappa^2 + (2/m)^2),    K_Q = 4.79e-7 m^3

    p is the pressure of the chamber at s. The moment of the pressure is K_Q p for a straight body.
    c is the part of this moment that a large curvature removes.
    """

    title = "chambers that flatten as the body bends"
    size: Scalar = parameter(0.0, 0.0, 0.8, "-", WHY)

    def moment(self, x, memory, dt):
        flat = jnp.square(x.kappa) / (jnp.square(x.kappa) + 4.0)
        return (1.0 - x.in_tail) * self.size * 4.79e-7 * x.pressure * flat, memory


class CurledTail(BendingMoment):
    """The sheet of the tail comes from a roll and is curled across, like a steel tape measure.

        M = EI (kappa + c kappa/(1 + (kappa/(2/m))^2))    in the tail

    The curled section is stiff. Bending flattens the section and removes this stiffness.
    """

    title = "tail with a curled section"
    size: Scalar = parameter(0.0, 0.0, 6.0, "-", WHY)

    def moment(self, x, memory, dt):
        curled = x.kappa / (1.0 + jnp.square(x.kappa / 2.0))
        return self.size * x.in_tail * x.EI * curled, memory


class VentilatedTail(ForceDensity):
    """The tail swims near the surface, and fast strokes draw air down, so added mass is lost.

        F_n = c rho pi H^2/4 a_n/(1 + exp(-(|u_n| - 0.3 m/s)/(0.05 m/s)))    on the tail
        a_n = du_n/dt + omega u_tau

    c is the part of the added mass that a section loses at a large speed.
    """

    title = "tail that draws air from the surface"
    size: Scalar = parameter(0.0, 0.0, 0.95, "-", WHY)

    def force(self, x):
        fast = jax.nn.sigmoid((jnp.abs(x.u_n) - 0.3) / 0.05)
        a_n = x.u_n_t + x.omega * x.u_tau
        F_n = self.size * x.in_tail * 250.0 * np.pi * jnp.square(x.height) * a_n * fast
        return jnp.zeros_like(F_n), F_n


class InletJet(ForceDensity):
    """The inlet of the tank's filter blows a narrow jet across the body, near its rear end.

        F_n = rho C H (|v| v + |u_n| u_n)/2 exp(-((s - 0.11 m)/25 mm)^2),    v = c - u_n

    The drag of the jet replaces the drag of the still water there, with C = 2. c is the speed of
    the jet.
    """

    title = "jet from the inlet of the filter"
    size: Scalar = parameter(0.0, -0.7, 0.7, "m/s", WHY)

    def force(self, x):
        v = self.size - x.u_n
        at = jnp.exp(-jnp.square((x.s - 0.11) / 0.025))
        F_n = 1000.0 * at * x.height * (jnp.abs(v) * v + jnp.abs(x.u_n) * x.u_n)
        return jnp.zeros_like(F_n), F_n


class RestlessWater(WaterMotion):
    """The operator waits too briefly after a trial, and the water still sloshes across the tank.

        U_y = c exp(-t/1.5 s) cos(2 pi 1.4 Hz t + 0.6)

    The frequency is the lowest one across a tank that is 0.4 m wide and 0.3 m deep.
    """

    title = "water that still sloshes after the previous trial"
    size: Scalar = parameter(0.0, -0.3, 0.3, "m/s", WHY)

    def velocity(self, t):
        U_y = self.size * jnp.exp(-t / 1.5) * jnp.cos(2.0 * np.pi * 1.4 * t + 0.6)
        return jnp.zeros_like(U_y), U_y


class ExceededRange(Instrument):
    """The pressure sensors have a range of only 1 bar, and their output saturates above it.

        p_read = p - c (S(p) - S(-p)),    S(p) = 8 kPa ln(1 + exp((p - 100 kPa)/8 kPa))

    c is the part of the pressure above 100 kPa that the reading lacks. The corner is smooth.
    """

    title = "pressure beyond the range of the sensors"
    sensors = ("pressure",)
    size: Scalar = parameter(0.0, 0.0, 1.0, "-", WHY)

    def read(self, true):
        def above(p):
            return 8e3 * jax.nn.softplus((p - 1e5) / 8e3)

        def saturated(p):
            return p - self.size * (above(p) - above(-p))

        return true._replace(pressures=saturated(true.pressures))


class TiltingBalance(Instrument):
    """The weight of the bent body acts beside the axis of the balance, which reads it as recoil.

        recoil_read = recoil + c tip

    The centre of the weight moves sideways with the tip. The beam that measures the recoil also
    responds to the moment about the axis of the head.
    """

    title = "weight of the bent body that tilts the balance"
    sensors = ("recoil",)
    size: Scalar = parameter(0.0, -20.0, 20.0, "N/m", WHY)

    def read(self, true):
        return true._replace(recoil=true.recoil + self.size * true.tip)


class SmoothedTrack(Instrument):
    """The tracking software smooths the path of the tip and so cuts the peaks of fast strokes.

        tip_read(t) = tip(t) + c (tip(t - T) - 2 tip(t) + tip(t + T))/4,    T = 50 ms

    c = 1 is a mean with the weights 1/4, 1/2 and 1/4. The path is constant before the first and
    after the last sample, and linear between samples.
    """

    title = "tracking software that smooths the path of the tip"
    sensors = ("tip",)
    size: Scalar = parameter(0.0, 0.0, 1.0, "-", WHY)

    def read(self, true):
        before, after = (jnp.interp(true.t + T, true.t, true.tip) for T in (-0.05, 0.05))
        change = 0.25 * (before - 2.0 * true.tip + after)
        return true._replace(tip=true.tip + self.size * change)


NOVEL_EFFECTS = {
    "integral_action": Whereabouts(PRESSURES, VALVES),
    "common_ground": Whereabouts(PRESSURES, VALVES),
    "late_release": Whereabouts(PRESSURES, VALVES),
    "mullins_sleeve": Whereabouts(FORCES, MOMENT),
    "flattening_chambers": Whereabouts(FORCES, MOMENT),
    "curled_tail": Whereabouts(FORCES, MOMENT),
    "ventilated_tail": Whereabouts(FORCES, WATER),
    "inlet_jet": Whereabouts(FORCES, WATER),
    "restless_water": Whereabouts(FORCES, WATER),
    "exceeded_range": Whereabouts(PRESSURES, ("Instrument",)),
    "tilting_balance": Whereabouts(("recoil",), ("Instrument",)),
    "smoothed_track": Whereabouts(("tip",), ("Instrument",)),
}
