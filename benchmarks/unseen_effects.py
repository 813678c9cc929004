"""Effects that the library lacks, written without reading the terms that the loop can learn.

The author had read the titles and docstrings of the library's effects, the base classes, the check
of an effect, the shared functions in `slider_jax.effects.functions`, the how-to on adding an effect
and the lists `unknown_effects`, `fresh_effects` and `blind_effects`. The author had not read the
dictionary of terms, its tests, the code that learns from it, the explanations of the loop, the
changelog or the history, and had run no simulation. The shared functions contain bases of terms
(powers, drifts and sines of a state), and a listing of folders showed the names of the dictionary's
files, so the author knew these. A stiffness that drifts with the time was considered and left out
after the author had seen the base for drifts. The other laws were not chosen with regard to it.
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


class IcingSilencer(Flow):
    """Expanding air cools the silencer of a vent, where moisture freezes and blocks the flow.

        dp/dt = q (1 - c z/(1 + z))    while |p| decreases
        dz/dt = v/(1 MPa) - z/(0.8 s)

    q is dp/dt without ice, v the rate at which |p| decreases [Pa/s], and z the ice. Each chamber
    has its own silencer. Heat from the room melts the ice.
    """

    title = "silencer that freezes while a chamber vents"
    states = 1
    size: Scalar = parameter(0.0, 0.0, 0.95, "-", WHY)

    def rate(self, rate, x):
        z = x.states[0]
        return rate * jnp.where(x.filling, 1.0, 1.0 - self.size * z / (1.0 + z))

    def state_rates(self, rate, x):
        vented = jnp.maximum(-x.side * rate, 0.0)
        return (vented / 1e6 - x.states[0] / 0.8)[None]


class SqueezedHose(Flow):
    """The rear chamber's hose runs through the front chamber, whose pressure squeezes it flat.

        dp_r/dt = (p_set - p_r)/k (1 - c S),    S = 1/(1 + exp(-(|p_f| - |p_r| - 30 kPa)/15 kPa))

    p_f and p_r are the pressures of front and rear chamber. The hose resists the first 30 kPa of
    the pressure difference. |p| is smoothed below 2 kPa.
    """

    title = "hose of the rear chamber that the front chamber squeezes"
    size: Scalar = parameter(0.0, 0.0, 0.95, "-", WHY)

    def rate(self, rate, x):
        size = jnp.sqrt(jnp.square(x.p) + 2e3**2)
        flat = jax.nn.sigmoid((size[::-1] - size - 3e4) / 1.5e4)
        return rate * (1.0 - self.size * x.rear * flat)


class Paced(Waveform):
    """The set pressure wave(t + share sin(w t)/w) with w = 2 pi 1.1 Hz."""

    wave: Waveform
    share: Scalar

    def segment(self, t0, t1):
        w = 2.0 * np.pi * 1.1

        def ahead(t):
            return self.share * jnp.sin(w * t) / w

        x = self.wave.segment(t0 + ahead(t0), t1 + ahead(t1))
        t = x.t_break
        for _ in range(3):  # Newton's method for t + ahead(t) = x.t_break
            t = t - (t + ahead(t) - x.t_break) / (1.0 + self.share * jnp.cos(w * t))
        return Segment(t0, jnp.clip(t, t0, t1), t1, x.a0, x.a1, x.b0, x.b1)


class BusyController(Command):
    """Another task of the valves' controller slows the program of the strides from time to time.

        p_set,valve(t) = p_set(t + c sin(w t)/w),    w = 2 pi 1.1 Hz

    The program runs at 1 + c cos(w t) times its speed, so it is right on average.
    """

    title = "controller that loses and regains time"
    size: Scalar = parameter(0.0, -0.4, 0.4, "-", WHY, physical=(-0.9, 0.9))

    def command(self, wave, rear):
        return Paced(wave, self.size)


class BulgingBulkhead(ActingPressure):
    """The soft wall between the chambers bulges into the chamber of the smaller pressure.

        p_act = p + c d |d|/(100 kPa),    d = p - p_other

    A bulge lengthens the chamber of the larger pressure and shortens the other one. The bulge and
    the force on it both grow with d, so the moment of the bulge is quadratic.
    """

    title = "wall between the chambers that bulges"
    size: Scalar = parameter(0.0, 0.0, 0.2, "-", WHY)

    def act(self, p, memory, dt):
        d = p - p[::-1]
        return p + self.size * d * jnp.abs(d) / 1e5, memory


class BlisterNearHead(BendingMoment):
    """The front chamber of one side has a thin spot near the head, which swells like a blister.

        M = EI kappa - c P exp(-((s - 0.32 m)/15 mm)^2)
        P = 15 kPa ln(1 + exp((p - 120 kPa)/15 kPa))

    p is the pressure in the chamber at s, positive on the side of the thin spot. P is the pressure
    above 120 kPa, with a smooth corner. c is the additional moment per pressure.
    """

    title = "blister on a chamber near the head"
    size: Scalar = parameter(0.0, 0.0, 5e-6, "m^3", WHY)

    def moment(self, x, memory, dt):
        above = 1.5e4 * jax.nn.softplus((x.pressure - 1.2e5) / 1.5e4)
        at = jnp.exp(-jnp.square((x.s - 0.32) / 0.015))
        return -self.size * (1.0 - x.in_tail) * at * above, memory


class PumpingFolds(BendingMoment):
    """Bending closes the folds of the sleeve, and water must leave through the narrow gaps.

        M = EI kappa + c d(kappa)/dt kappa^2/(kappa^2 + (2/m)^2)    in the body

    The gaps of the straight sleeve are wide and cause no damping. The gaps on the concave side
    become narrow as the curvature grows.
    """

    title = "folds of the sleeve that pump water"
    size: Scalar = parameter(0.0, 0.0, 3e-3, "N m^2 s", WHY)

    def moment(self, x, memory, dt):
        closed = jnp.square(x.kappa) / (jnp.square(x.kappa) + 4.0)
        return (1.0 - x.in_tail) * self.size * x.kappa_t * closed, memory


class WakeReentry(ForceDensity):
    """After each reversal, the body moves against its own wake, so the drag is larger at first.

        F_n = -rho C H |u_n| u_n/2 (1 + tanh(u_n a_n/(1 m^2/s^3)))/2,    a_n = du_n/dt + omega u_tau

    The wake follows the body and meets it after the reversal. The drag is increased while the body
    accelerates, and not while it decelerates.
    """

    title = "body that meets its own wake"
    size: Scalar = parameter(0.0, 0.0, 10.0, "-", WHY)

    def force(self, x):
        a_n = x.u_n_t + x.omega * x.u_tau
        met = 0.5 * (1.0 + jnp.tanh(x.u_n * a_n))
        F_n = -500.0 * self.size * met * x.height * jnp.abs(x.u_n) * x.u_n
        return jnp.zeros_like(F_n), F_n


class NearbyWall(ForceDensity):
    """The robot is mounted near a wall of the tank, and the added mass grows beside the wall.

        F_n = -c rho pi H^2/4 a_n/(1 + exp(-(y - 40 mm)/15 mm)),    a_n = du_n/dt + omega u_tau

    y = (0.368 m - s) phi/2 is the distance of a section from the axis of the head, for a body of
    uniform curvature. The wall is on the side of positive y.
    """

    title = "wall of the tank on one side"
    size: Scalar = parameter(0.0, 0.0, 3.0, "-", WHY)

    def force(self, x):
        y = 0.5 * (0.368 - x.s) * x.phi
        beside = jax.nn.sigmoid((y - 0.04) / 0.015)
        a_n = x.u_n_t + x.omega * x.u_tau
        F_n = -self.size * 250.0 * np.pi * jnp.square(x.height) * a_n * beside
        return jnp.zeros_like(F_n), F_n


class FilterPump(WaterMotion):
    """The filter pump of the tank starts during the trial and drives an oblique current.

    (U_x, U_y) = c (0.8, 0.6) (1 + tanh((t - 0.5 s)/0.06 s))/2
    """

    title = "filter pump that starts"
    size: Scalar = parameter(0.0, -0.5, 0.5, "m/s", WHY)

    def velocity(self, t):
        speed = self.size * 0.5 * (1.0 + jnp.tanh((t - 0.5) / 0.06))
        return 0.8 * speed, 0.6 * speed


class ArchingFlexure(Instrument):
    """The leaf springs of the balance move on an arc under the recoil, which reads as thrust.

        thrust_read = thrust + c recoil^2

    A parallelogram of leaf springs shortens with the square of its lateral deflection.
    """

    title = "leaf springs that move on an arc"
    sensors = ("thrust",)
    size: Scalar = parameter(0.0, -0.5, 0.5, "1/N", WHY)

    def read(self, true):
        return true._replace(thrust=true.thrust + self.size * jnp.square(true.recoil))


class TapInTheHose(Instrument):
    """The pressure sensors are at the valves, so they also read the turbulent loss in the hose.

        p_read = p + c dp/dt |dp/dt|/(1 MPa/s)^2

    While a chamber fills, the pressure at the valve exceeds the chamber's pressure. The rate is the
    difference of two samples, divided by the time between them.
    """

    title = "pressure sensors that read the loss in the hose"
    sensors = ("pressure",)
    size: Scalar = parameter(0.0, 0.0, 5e3, "Pa", WHY)

    def read(self, true):
        def loss(p):
            rate = jnp.diff(p, prepend=p[:1]) / (1e6 * (true.t[1] - true.t[0]))
            return self.size * rate * jnp.abs(rate)

        return true._replace(pressures=true.pressures + jax.vmap(loss)(true.pressures))


class BreathingLens(Instrument):
    """The autofocus of the camera hunts, and the lens changes its magnification with the focus.

    tip_read = tip (1 + c sin(2 pi 2.3 Hz t + 0.5))
    """

    title = "autofocus that hunts"
    sensors = ("tip",)
    size: Scalar = parameter(0.0, -0.5, 0.5, "-", WHY, physical=(-1.0, 1.0))

    def read(self, true):
        focus = jnp.sin(2.0 * np.pi * 2.3 * true.t + 0.5)
        return true._replace(tip=true.tip * (1.0 + self.size * focus))


UNSEEN_EFFECTS = {
    "icing_silencer": Whereabouts(PRESSURES, VALVES),
    "squeezed_hose": Whereabouts(PRESSURES, VALVES),
    "busy_controller": Whereabouts(PRESSURES, VALVES),
    "bulging_bulkhead": Whereabouts(FORCES, MOMENT),
    "blister_near_head": Whereabouts(FORCES, MOMENT),
    "pumping_folds": Whereabouts(FORCES, MOMENT),
    "wake_reentry": Whereabouts(FORCES, WATER),
    "nearby_wall": Whereabouts(FORCES, WATER),
    "filter_pump": Whereabouts(FORCES, WATER),
    "arching_flexure": Whereabouts(("thrust",), ("Instrument",)),
    "tap_in_the_hose": Whereabouts(PRESSURES, ("Instrument",)),
    "breathing_lens": Whereabouts(("tip",), ("Instrument",)),
}
