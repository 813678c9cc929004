"""Effects of a soft-robotics laboratory that the library lacks, in the form of `unknown_effects`.

The laws come from physics and laboratory experience. The author had not read the dictionary of
terms, the learning code or the explanations in the documentation. While the file was written, the
author did see slider_jax/effects/functions.py, which contains basis functions of terms. Eleven of
the laws were chosen before that, and `FieldSlippingClamp` and the constants after that.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
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
from slider_jax.effects.functions import lagged, resonant


class FieldTrappedPocket(Flow):
    """A wall has delaminated, and a flap lets air into the pocket in 30 ms and out in 400 ms.

    The pocket has `size` times the volume of the chamber, and each side has its own pocket.
    """

    title = "delaminated pocket behind a flap"
    states = 2
    FILL: ClassVar[float] = 0.03
    EMPTY: ClassVar[float] = 0.4
    size: Scalar = parameter(0.0, 0.0, 1.5, "-", WHY)

    def start(self, p):
        return jnp.stack([jnp.maximum(p, 0.0), jnp.maximum(-p, 0.0)])

    def rate(self, rate, x):
        left, right = self.state_rates(rate, x)
        return rate - self.size * jnp.where(x.side >= 0.0, left, -right)

    def state_rates(self, rate, x):
        p = jnp.stack([jnp.maximum(x.p, 0.0), jnp.maximum(-x.p, 0.0)])
        flow_in = jnp.maximum(p - x.states, 0.0) / self.FILL
        return flow_in - jnp.maximum(x.states - p, 0.0) / self.EMPTY


class FieldBallooningBladder(Flow):
    """The bladder balloons through a gap of its sleeve at about 140 kPa, where its volume grows.

    Around this pressure, a rise in pressure needs up to 1 + `size` times the usual amount of air.
    """

    title = "bladder that balloons through a gap"
    PRESSURE: ClassVar[float] = 140e3
    WIDTH: ClassVar[float] = 35e3
    size: Scalar = parameter(0.0, 0.0, 4.0, "-", WHY)

    def rate(self, rate, x):
        near = jnp.exp(-jnp.square((jnp.abs(x.p) - self.PRESSURE) / self.WIDTH))
        return rate / (1.0 + self.size * near)


class FieldBraidFriction(ActingPressure):
    """The fibres of the braid creep past one another while the pressure changes.

    Their friction follows Eyring's law: it grows with the inverse hyperbolic sine of dp/dt.
    """

    title = "fibres of the braid that creep past one another"
    RATE: ClassVar[float] = 2e5
    size: Scalar = parameter(0.0, 0.0, 25e3, "Pa", WHY)

    def act(self, p, memory, dt):
        p_t = (p - memory[1]) / dt
        return p - self.size * jnp.arcsinh(p_t / self.RATE), jnp.stack([p, p])


class FieldSlippingClamp(BendingMoment):
    """The hose clamp near the head carries the share `size` of the stiffness by its grip.

    The grip slips beyond a change in curvature of 1 1/m, as a spring in series with dry friction.
    """

    title = "hose clamp near the head that slips"
    SLIP: ClassVar[float] = 1.0
    CREEP: ClassVar[float] = 1.0
    LENGTH: ClassVar[float] = 0.03
    size: Scalar = parameter(0.0, 0.0, 0.9, "-", WHY)

    def moment(self, x, memory, dt):
        speed = jnp.sqrt(x.kappa_t**2 + self.CREEP**2)
        q = (memory + dt * x.kappa_t / self.SLIP) / (1.0 + dt * speed / self.SLIP)
        from_head = x.s[-1] - x.s
        at = (1.0 - x.in_tail) * jnp.exp(-jnp.square(from_head / self.LENGTH))
        return -at * self.size * x.EI * (x.kappa - self.SLIP * q), q


class FieldTackyRibs(BendingMoment):
    """Silicone ribs touch beyond a curvature of 2 1/m, and their contact bonds within 50 ms.

    When the body unbends, the bond holds the ribs together over a small gap, and then it decays.
    """

    title = "silicone ribs that stick together"
    CONTACT: ClassVar[float] = 2.0
    SOFTNESS: ClassVar[float] = 0.1
    REACH: ClassVar[float] = 0.8
    BONDING: ClassVar[float] = 0.05
    size: Scalar = parameter(0.0, 0.0, 0.04, "N m", WHY)

    def moment(self, x, memory, dt):
        bend = jnp.abs(x.kappa)
        touching = jax.nn.sigmoid((bend - self.CONTACT) / self.SOFTNESS)
        bond = (memory + dt * touching / self.BONDING) / (1.0 + dt / self.BONDING)
        gap = jnp.maximum(self.CONTACT - bend, 0.0) / self.REACH
        pull = gap * jnp.exp(0.5 - 0.5 * jnp.square(gap)) * jnp.tanh(x.kappa / 0.2)
        return -(1.0 - x.in_tail) * self.size * bond * pull, bond


class FieldOpeningCut(BendingMoment):
    """A cut across one wall opens when the body bends away from it, and closes on the other side.

    Up to 30 mm from the cut, the body loses the share `size` of its stiffness while the cut opens.
    """

    title = "cut in one wall that opens"
    PLACE: ClassVar[float] = 0.28
    LENGTH: ClassVar[float] = 0.03
    ROUNDING: ClassVar[float] = 0.2
    size: Scalar = parameter(0.0, 0.0, 0.9, "-", WHY)

    def moment(self, x, memory, dt):
        opened = 0.5 * (x.kappa + jnp.sqrt(x.kappa**2 + self.ROUNDING**2) - self.ROUNDING)
        at = (1.0 - x.in_tail) * jnp.exp(-jnp.square((x.s - self.PLACE) / self.LENGTH))
        return -at * self.size * x.EI * opened, memory


class FieldStallingTail(ForceDensity):
    """The tail has the lift of a short wing, which it loses at flow angles beyond about 36 degrees.

    The lift is proportional to the axial and to the lateral speed, with the slope `size`.
    """

    title = "tail that stalls"
    DENSITY: ClassVar[float] = 1000.0
    STALL: ClassVar[float] = 0.35
    WIDTH: ClassVar[float] = 0.06
    STILL: ClassVar[float] = 1e-4
    size: Scalar = parameter(0.0, 0.0, 25.0, "-", WHY)

    def force(self, x):
        square = x.u_tau**2 + self.STILL
        angle = x.u_n**2 / (square + x.u_n**2)
        attached = jax.nn.sigmoid((self.STALL - angle) / self.WIDTH)
        lift = 0.5 * self.DENSITY * self.size * x.height * jnp.sqrt(square) * x.u_n
        F_n = -x.in_tail * attached * lift
        return jnp.zeros_like(F_n), F_n


class FieldCuppedDrag(ForceDensity):
    """A bent body has more drag when its concave side leads, because it cups the water.

    With the convex side leading, the drag is smaller by the same amount. The change saturates
    beyond a curvature of 1 1/m.
    """

    title = "bent body that cups the water"
    DENSITY: ClassVar[float] = 1000.0
    CURVATURE: ClassVar[float] = 1.0
    size: Scalar = parameter(0.0, 0.0, 3.5, "-", WHY)

    def force(self, x):
        cupped = jnp.tanh(x.kappa / self.CURVATURE)
        F_n = -0.5 * self.DENSITY * self.size * x.height * x.u_n**2 * cupped
        return jnp.zeros_like(F_n), F_n


class FieldStrutWake(WaterMotion):
    """The strut of 15 mm that carries the robot is towed ahead of it and sheds vortices.

    The wake moves the water along with the strut and to and fro, at a Strouhal number of 0.2.
    """

    title = "wake of the strut"
    DIAMETER: ClassVar[float] = 0.015
    STROUHAL: ClassVar[float] = 0.2
    DEFICIT: ClassVar[float] = 0.5
    size: Scalar = parameter(0.0, 0.0, 1.0, "-", WHY)
    tow_speed: Scalar = eqx.field(default=0.1)

    def velocity(self, t):
        speed = self.size * self.tow_speed
        angle = 2.0 * np.pi * self.STROUHAL * self.tow_speed / self.DIAMETER * t
        return self.DEFICIT * speed + jnp.zeros_like(t), speed * jnp.sin(angle)


class FieldThermalShock(Instrument):
    """The gas warms the membrane of a pressure sensor when it is compressed, for about 60 ms.

    A sudden rise by 100 kPa reduces the sensitivity by the share `size`, and a fall increases it.
    """

    title = "thermal shock of the pressure sensors"
    sensors = ("pressure",)
    TAU: ClassVar[float] = 0.06
    UNIT: ClassVar[float] = 1e5
    size: Scalar = parameter(0.0, 0.0, 0.4, "-", WHY)

    def read(self, true):
        p = jnp.abs(true.pressures) / self.UNIT
        warmth = p - jax.vmap(lagged, (0, None, None))(p, true.t, self.TAU)
        return true._replace(pressures=true.pressures * (1.0 - self.size * warmth))


class FieldOffCentreLoad(Instrument):
    """The thrust acts where the tail is, beside the axis, and its moment bends the force sensor.

    The sensor reads this moment, which is thrust times tip, as a part of the recoil.
    """

    title = "off-centre load on the force sensor"
    sensors = ("recoil",)
    size: Scalar = parameter(0.0, -40.0, 40.0, "1/m", WHY)

    def read(self, true):
        return true._replace(recoil=true.recoil + self.size * true.thrust * true.tip)


class FieldRippledSurface(Instrument):
    """The camera looks through the water's surface, which the tail sets in motion at 2.8 Hz.

    The slope of the surface is a damped oscillator driven by the tip's speed, and refraction shifts
    the image of the tip by `size` times its response.
    """

    title = "refraction at the rippled surface"
    sensors = ("tip",)
    FREQUENCY: ClassVar[float] = 2.8
    DAMPING: ClassVar[float] = 0.15
    size: Scalar = parameter(0.0, -0.05, 0.05, "s", WHY)

    def read(self, true):
        speed = jnp.diff(true.tip, prepend=true.tip[:1]) / (true.t[1] - true.t[0])
        w = 2.0 * np.pi * self.FREQUENCY
        slope = resonant(speed, true.t, 1.0 / w**2, 2.0 * self.DAMPING * w)
        return true._replace(tip=true.tip + self.size * slope)


FIELD_EFFECTS = {
    "field_trapped_pocket": Whereabouts(PRESSURES, VALVES),
    "field_ballooning_bladder": Whereabouts(PRESSURES, VALVES),
    "field_braid_friction": Whereabouts(FORCES, MOMENT),
    "field_slipping_clamp": Whereabouts(FORCES, MOMENT),
    "field_tacky_ribs": Whereabouts(FORCES, MOMENT),
    "field_opening_cut": Whereabouts(FORCES, MOMENT),
    "field_stalling_tail": Whereabouts(FORCES, WATER),
    "field_cupped_drag": Whereabouts(FORCES, WATER),
    "field_strut_wake": Whereabouts(FORCES, WATER),
    "field_thermal_shock": Whereabouts(PRESSURES, ("Instrument", *VALVES)),
    "field_off_centre_load": Whereabouts(("recoil",), ("Instrument",)),
    "field_rippled_surface": Whereabouts(("tip",), ("Instrument",)),
}
