"""Terms of the readings of each sensor."""

from abc import abstractmethod
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.actuation.waveform import rear_of
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import (
    Curve,
    Instrument,
    Readings,
    mean_of_others,
    parameter,
    shape_parameter,
)
from slider_jax.effects.functions import (
    MEMORY_TIMES,
    WHY_FREQUENCY,
    Basis,
    Drift,
    Powers,
    Sine,
    delayed,
    even_powers,
    lagged,
    mixed_powers,
    odd_corners,
    odd_powers,
)

FRICTION_WIDTHS = (0.1, 0.3, 1.0)
"""Changes of a reading in which dry friction builds up, divided by the scale of the sensor."""
DELAY = 0.02
"""Delay [s] that one unit of a delay's parameters causes: a frame of a camera at 50 Hz."""
SETTLING_TIME = 0.5
"""Time constant [s] of a drift that settles: a few strides."""
RATE_TIME = 0.05
"""Time [s] that multiplies the rate of a reading: a quarter of a stride at 5 Hz."""
WHY = "a sensor with an error as large as its scale is broken"
OF_TIME = Curve("time t", "s", "change divided by the scale", "-")
OF_PHASE = Curve("phase, the fraction of f t", "-", "change divided by the scale", "-")
OF_READING = Curve("reading divided by its scale", "-", "change divided by the scale", "-")
OF_PRESSURE = Curve("pressure divided by 100 kPa", "-", "change divided by the scale", "-")
OF_TIP = Curve("tip position divided by 20 mm", "-", "change divided by the scale", "-")
OF_STEP = Curve("time t after a step of the reading", "s", "change divided by the step", "-")
OF_FIRST_LOAD = Curve("first reading divided by its scale", "-", "change divided by the scale", "-")
OF_RECOIL = Curve("recoil divided by 1 N", "-", "change divided by the scale", "-")
OF_THRUST = Curve("thrust divided by 0.2 N", "-", "change divided by the scale", "-")
OF_RATE = Curve("change of the reading in 0.05 s/scale", "-", "change divided by the scale", "-")
OF_GAIN_PHASE = Curve("phase, the fraction of f t", "-", "change of the gain", "-")
OF_GAIN = Curve("time t", "s", "change of the gain", "-")


class Sensor(NamedTuple):
    """Field of `Readings` that one kind of sensor records, and the scale of its errors."""

    name: str
    scale: float
    """Typical reading, in the unit of the sensor. All parameters are divided by this scale."""

    def of(self, x: Readings) -> Array:
        """Returns the readings (sensors, n) of the kind, divided by their scale."""
        return jnp.atleast_2d(getattr(x, self.name)) / self.scale


PRESSURE = Sensor("pressures", 100e3)
THRUST = Sensor("thrust", 0.2)
RECOIL = Sensor("recoil", 1.0)
TIP = Sensor("tip", 0.02)


class SensorTerm(Instrument):
    """y_read = y + s f, with a function f and the scale s of the sensor."""

    @abstractmethod
    def sensor(self) -> Sensor:
        """Returns the sensor whose readings change."""

    @abstractmethod
    def change(self, z: Array, true: Readings) -> Array:
        """Returns f for readings z (n,) of the sensor, divided by their scale."""

    def read(self, true):
        name, scale = self.sensor()
        y = getattr(true, name)

        def one(y):
            return y + scale * self.change(y / scale, true)

        return true._replace(**{name: one(y) if y.ndim == true.t.ndim else jax.vmap(one)(y)})


def _in_chamber(rear: float, read: Readings, true: Readings) -> Readings:
    """Returns `read`, with the `true` pressures in all chambers but that of the order `rear`."""
    here = rear_of(true.pressures.shape[0]) == rear
    pressures = jnp.where(here[:, None], read.pressures, true.pressures)
    return read._replace(pressures=pressures)


class FrontSensorTerm(SensorTerm):
    """A term of the pressure sensors that changes only the first chamber's reading."""

    def read(self, true):
        return _in_chamber(0.0, super().read(true), true)


class RearReading:
    """The sensor of the last chamber's pressure; only its reading changes."""

    def read(self, true):
        return _in_chamber(1.0, super().read(true), true)  # type: ignore[misc]


class OfPressure:
    """The sensors of the pressures."""

    sensors: ClassVar[tuple[str, ...]] = ("pressure",)

    def sensor(self) -> Sensor:
        return PRESSURE


class OfThrust:
    """The sensor of the thrust."""

    sensors: ClassVar[tuple[str, ...]] = ("thrust",)

    def sensor(self) -> Sensor:
        return THRUST


class OfRecoil:
    """The sensor of the recoil."""

    sensors: ClassVar[tuple[str, ...]] = ("recoil",)

    def sensor(self) -> Sensor:
        return RECOIL


class OfTip:
    """The sensor of the tip."""

    sensors: ClassVar[tuple[str, ...]] = ("tip",)

    def sensor(self) -> Sensor:
        return TIP


class SensorPowers(Powers, SensorTerm):
    """f is a sum of three functions of the reading of a sensor, the source."""

    scale: Scalar = shape_parameter(1.0, 1e-3, 1e3, "-", "the readings of a soft robot")
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the predicted |readings| of the source, divided by the scale of the source."""

    @abstractmethod
    def source(self) -> Sensor:
        """Returns the sensor on whose reading f depends."""

    def state(self, x: Readings) -> Array:
        """Returns the readings of the source, divided by their scale."""
        return self.source().of(x)

    @abstractmethod
    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the reading z of the source."""


class OwnPowers(SensorPowers):
    """f is a function of the sensor's own reading."""

    term_curve = OF_READING

    def source(self):
        return self.sensor()

    def change(self, z, true):
        return self.total(self.basis(z))


class SensorOddPowers(OwnPowers):
    """f is an odd function of the reading."""

    def basis(self, z):
        return odd_powers(z / self.scale)


class SensorEvenPowers(OwnPowers):
    """f is an even function of the reading."""

    def basis(self, z):
        return even_powers(z / self.scale)


class SensorCorners(OwnPowers):
    """f is an odd function of the reading that has corners."""

    def basis(self, z):
        return odd_corners(z / self.scale)


class OtherPowers(SensorPowers):
    """f is a sum of q, |q| and q^2, where q is the reading of another sensor, the source.

    If the source has several fields, as the pressure sensors have, f is the sum over all fields.
    """

    def basis(self, z):
        return mixed_powers(z / self.scale)

    def change(self, z, true):
        return self.total(self.basis(self.state(true))).sum(axis=0)


class SensorOfRate(SensorPowers):
    """f is an odd function of 0.05 s dq/dt. q is the reading divided by the scale."""

    term_curve = OF_RATE

    def source(self):
        return self.sensor()

    def state(self, x: Readings) -> Array:
        """Returns the rate of the readings, times 0.05 s and divided by the scale."""
        return self._rate(self.sensor().of(x), x.t)

    def _rate(self, z: Array, t: Array) -> Array:
        # The first interval can differ from the others.
        return RATE_TIME * jnp.asarray(jnp.gradient(z, axis=-1)) / jnp.asarray(jnp.gradient(t))

    def basis(self, z):
        return odd_powers(z / self.scale)

    def change(self, z, true):
        return self.total(self.basis(self._rate(z, true.t)))


class SensorMemory(Powers, SensorTerm):
    """f is a sum of three lagged readings, with the time constants in `MEMORY_TIMES`.

        tau dy/dt = q - y,    y(0) = 0

    q is the reading divided by the scale. The sum describes a sensor that creeps, leaks or lags.
    """

    term_curve = OF_STEP

    def state(self, x: Readings) -> Array:
        """Returns the time [s]."""
        return x.t

    def basis(self, z: Array) -> Basis:
        """Returns the three lagged readings at a time z after a step of size 1."""
        first, second, third = (1.0 - jnp.exp(-z / tau) for tau in MEMORY_TIMES)
        return first, second, third

    def change(self, z, true):
        start = jnp.zeros_like(z[0])
        first, second, third = (lagged(z, true.t, tau, start) for tau in MEMORY_TIMES)
        return self.total((first, second, third))


class SensorHysteresis(Powers, SensorTerm):
    """f is a sum of three states of dry friction, with the widths w in `FRICTION_WIDTHS`.

        w dz/dt = dq/dt - |dq/dt| z,    z(0) = 0

    q is the reading divided by the scale. z is between -1 and 1. Source: Dahl's model, see
    `internal_friction`.
    """

    term_curve = OF_FIRST_LOAD

    def state(self, x: Readings) -> Array:
        """Returns the reading, divided by the scale of the sensor."""
        return self.sensor().of(x)

    def basis(self, z: Array) -> Basis:
        """Returns the three states after a reading rises from 0 to z."""
        first, second, third = (
            jnp.sign(z) * (1.0 - jnp.exp(-jnp.abs(z) / w)) for w in FRICTION_WIDTHS
        )
        return first, second, third

    def change(self, z, true):
        first, second, third = (friction_states(z, w) for w in FRICTION_WIDTHS)
        return self.total((first, second, third))


def friction_states(q: Array, width: float) -> Array:
    """Returns the state z (n,) of dry friction for readings q (n,). z is 0 at the first reading."""

    def body(z, change):
        sign = jnp.sign(change)
        z = sign + (z - sign) * jnp.exp(-jnp.abs(change) / width)
        return z, z

    _, z = jax.lax.scan(body, jnp.zeros_like(q[0]), jnp.diff(q))
    return jnp.concatenate([jnp.zeros_like(z[:1]), z])


class SensorDelay(SensorPowers):
    """y_read(t) = y(t - d), with a delay d that is a function of the reading.

    d is a sum of q, |q| and q^2 times `DELAY`. q is the reading divided by the scale.
    """

    term_curve = Curve("reading divided by its scale", "-", "delay", "s")

    def source(self):
        return self.sensor()

    def basis(self, z):
        return mixed_powers(z / self.scale, DELAY)

    def change(self, z, true):
        return delayed(z, true.t, self.total(self.basis(z))) - z


class TimeTerm(Drift, SensorTerm):
    """f depends on a t + b (1 - exp(-t/0.5 s)), with the time t of the trial."""

    a: Scalar = parameter(0.0, -1.0, 1.0, "1/s", WHY)
    """a, drift."""
    b: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY)
    """b, drift that settles."""

    def state(self, x: Readings) -> Array:
        """Returns the time [s]."""
        return x.t

    def basis(self, z):
        return z, -jnp.expm1(-z / SETTLING_TIME)


class SensorDrift(TimeTerm):
    """f = a t + b (1 - exp(-t/0.5 s))."""

    term_curve = OF_TIME

    def change(self, z, true):
        return self.drift(true.t)


class SensorGainDrift(TimeTerm):
    """f = (a t + b (1 - exp(-t/0.5 s))) y/s, with the reading y."""

    term_curve = OF_GAIN

    def change(self, z, true):
        return z * self.drift(true.t)


class SensorSine(Sine, SensorTerm):
    """y_read = y + s (a sin(2 pi f t) + b cos(2 pi f t)), with the frequency f."""

    term_curve = OF_PHASE

    a: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY)
    """a, amplitude of the sine."""
    b: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY)
    """b, amplitude of the cosine."""
    frequency: Scalar = shape_parameter(10.0, 0.1, 500.0, "Hz", WHY_FREQUENCY)
    """f, frequency of the most significant sine in the residual."""

    def change(self, z, true):
        return self.at(true.t)


class SensorGainSine(SensorSine):
    """y_read = y (1 + a sin(2 pi f t) + b cos(2 pi f t)), with the frequency f."""

    term_curve = OF_GAIN_PHASE
    of_gain = True

    def change(self, z, true):
        return z * self.at(true.t)


class PressureReadingPowers(OfPressure, SensorOddPowers):
    """An error that is an odd function of the reading of the pressure sensors."""

    title = "nonlinearity of the pressure sensors"


class PressureReadingWithCorners(OfPressure, SensorCorners):
    """An error that is an odd function of the reading of the pressure sensors and has corners."""

    title = "nonlinearity of the pressure sensors, with corners"


class PressureReadingPowersBySign(OfPressure, SensorEvenPowers):
    """An error that is an even function of the reading of the pressure sensors."""

    title = "nonlinearity of the pressure sensors that depends on the sign"


class FrontPressureReading(FrontSensorTerm, OfPressure, OwnPowers):
    """An error of the first chamber's pressure sensor that is a function f of the reading.

    f is a sum of q, |q| and q^2. q is the reading divided by 100 kPa.
    """

    title = "error of the first chamber's pressure sensor"

    def basis(self, z):
        return mixed_powers(z / self.scale)


class PressureReadingHysteresis(OfPressure, SensorHysteresis):
    """A hysteresis of the pressure sensors."""

    title = "hysteresis of the pressure sensors"


class FrontPressureReadingHysteresis(FrontSensorTerm, OfPressure, SensorHysteresis):
    """A hysteresis of the first chamber's pressure sensor."""

    title = "hysteresis of the first chamber's pressure sensor"


class PressureReadingDrift(OfPressure, SensorDrift):
    """A drift of the pressure sensors."""

    title = "drift of the pressure sensors"


class PressureReadingGainDrift(OfPressure, SensorGainDrift):
    """A drift of the gain of the pressure sensors."""

    title = "drift of the gain of the pressure sensors"


class PressureReadingMemory(OfPressure, SensorMemory):
    """A memory of the pressure sensors: the readings depend on earlier readings."""

    title = "memory of the pressure sensors"


class PressureReadingOfOther(OfPressure, SensorPowers):
    """An error of each pressure sensor that is a function of the other chambers' pressure.

    f is a sum of q, |q| and q^2. q is the mean pressure of the other chambers divided by 100 kPa.
    """

    title = "error of the pressure sensors that depends on the other chambers' pressure"
    term_curve = Curve("other pressure divided by 100 kPa", "-", "change divided by 100 kPa", "-")

    def source(self):
        return PRESSURE

    def basis(self, z):
        return mixed_powers(z / self.scale)

    def change(self, z, true):
        return self.total(self.basis(z))

    def read(self, true):
        others = mean_of_others(self.state(true).T).T
        pressures = true.pressures + PRESSURE.scale * self.change(others, true)
        return true._replace(pressures=pressures)


class PressureReadingOfRate(OfPressure, SensorOfRate):
    """An error of the pressure sensors that depends on the rate of the reading."""

    title = "error of the pressure sensors that depends on the rate of the reading"


class PressureReadingGainSine(OfPressure, SensorGainSine):
    """A sine in the gain of the pressure sensors."""

    title = "a sine in the gain of the pressure sensors"


class PressureReadingSine(OfPressure, SensorSine):
    """A sine in the readings of the pressure sensors."""

    title = "a sine in the readings of the pressure sensors"


class ThrustReadingPowers(OfThrust, SensorOddPowers):
    """An error that is an odd function of the reading of the thrust sensor."""

    title = "nonlinearity of the thrust sensor"


class ThrustReadingWithCorners(OfThrust, SensorCorners):
    """An error that is an odd function of the reading of the thrust sensor and has corners."""

    title = "nonlinearity of the thrust sensor, with corners"


class ThrustReadingPowersBySign(OfThrust, SensorEvenPowers):
    """An error that is an even function of the reading of the thrust sensor."""

    title = "nonlinearity of the thrust sensor that depends on the sign"


class ThrustReadingDrift(OfThrust, SensorDrift):
    """A drift of the thrust sensor."""

    title = "drift of the thrust sensor"


class ThrustReadingGainDrift(OfThrust, SensorGainDrift):
    """A drift of the gain of the thrust sensor."""

    title = "drift of the gain of the thrust sensor"


class ThrustReadingMemory(OfThrust, SensorMemory):
    """A memory of the thrust sensor: the readings depend on earlier readings."""

    title = "memory of the thrust sensor"


class ThrustReadingHysteresis(OfThrust, SensorHysteresis):
    """A hysteresis of the thrust sensor."""

    title = "hysteresis of the thrust sensor"


class ThrustReadingOfRate(OfThrust, SensorOfRate):
    """An error of the thrust sensor that depends on the rate of the reading."""

    title = "error of the thrust sensor that depends on the rate of the reading"


class ThrustReadingGainSine(OfThrust, SensorGainSine):
    """A sine in the gain of the thrust sensor."""

    title = "a sine in the gain of the thrust sensor"


class ThrustReadingSine(OfThrust, SensorSine):
    """A sine in the readings of the thrust sensor."""

    title = "a sine in the readings of the thrust sensor"


class ThrustReadingOfPressure(OfThrust, OtherPowers):
    """An error of the thrust sensor that is a function of the pressures."""

    title = "error of the thrust sensor that depends on the pressures"
    term_curve = OF_PRESSURE

    def source(self):
        return PRESSURE


class ThrustReadingOfTip(OfThrust, OtherPowers):
    """An error of the thrust sensor that is a function of the tip position."""

    title = "error of the thrust sensor that depends on the tip position"
    term_curve = OF_TIP

    def source(self):
        return TIP


class RecoilReadingPowers(OfRecoil, SensorOddPowers):
    """An error that is an odd function of the reading of the recoil sensor."""

    title = "nonlinearity of the recoil sensor"


class RecoilReadingWithCorners(OfRecoil, SensorCorners):
    """An error that is an odd function of the reading of the recoil sensor and has corners."""

    title = "nonlinearity of the recoil sensor, with corners"


class RecoilReadingPowersBySign(OfRecoil, SensorEvenPowers):
    """An error that is an even function of the reading of the recoil sensor."""

    title = "nonlinearity of the recoil sensor that depends on the sign"


class RecoilReadingDrift(OfRecoil, SensorDrift):
    """A drift of the recoil sensor."""

    title = "drift of the recoil sensor"


class RecoilReadingGainDrift(OfRecoil, SensorGainDrift):
    """A drift of the gain of the recoil sensor."""

    title = "drift of the gain of the recoil sensor"


class RecoilReadingMemory(OfRecoil, SensorMemory):
    """A memory of the recoil sensor: the readings depend on earlier readings."""

    title = "memory of the recoil sensor"


class RecoilReadingHysteresis(OfRecoil, SensorHysteresis):
    """A hysteresis of the recoil sensor."""

    title = "hysteresis of the recoil sensor"


class RecoilReadingOfRate(OfRecoil, SensorOfRate):
    """An error of the recoil sensor that depends on the rate of the reading."""

    title = "error of the recoil sensor that depends on the rate of the reading"


class RecoilReadingGainSine(OfRecoil, SensorGainSine):
    """A sine in the gain of the recoil sensor."""

    title = "a sine in the gain of the recoil sensor"


class RecoilReadingSine(OfRecoil, SensorSine):
    """A sine in the readings of the recoil sensor."""

    title = "a sine in the readings of the recoil sensor"


class RecoilReadingOfPressure(OfRecoil, OtherPowers):
    """An error of the recoil sensor that is a function of the pressures."""

    title = "error of the recoil sensor that depends on the pressures"
    term_curve = OF_PRESSURE

    def source(self):
        return PRESSURE


class RecoilReadingOfTip(OfRecoil, OtherPowers):
    """An error of the recoil sensor that is a function of the tip position."""

    title = "error of the recoil sensor that depends on the tip position"
    term_curve = OF_TIP

    def source(self):
        return TIP


class TipReadingPowers(OfTip, SensorOddPowers):
    """An error that is an odd function of the reading of the tip sensor."""

    title = "nonlinearity of the tip sensor"


class TipReadingWithCorners(OfTip, SensorCorners):
    """An error that is an odd function of the reading of the tip sensor and has corners."""

    title = "nonlinearity of the tip sensor, with corners"


class TipReadingPowersBySign(OfTip, SensorEvenPowers):
    """An error that is an even function of the reading of the tip sensor."""

    title = "nonlinearity of the tip sensor that depends on the sign"


class TipReadingDrift(OfTip, SensorDrift):
    """A drift of the tip sensor."""

    title = "drift of the tip sensor"


class TipReadingGainDrift(OfTip, SensorGainDrift):
    """A drift of the gain of the tip sensor."""

    title = "drift of the gain of the tip sensor"


class TipReadingMemory(OfTip, SensorMemory):
    """A memory of the tip sensor: the readings depend on earlier readings."""

    title = "memory of the tip sensor"


class TipReadingDelay(OfTip, SensorDelay):
    """A delay of the tip sensor that depends on the tip position."""

    title = "delay of the tip sensor that depends on the tip position"


class TipReadingOfRate(OfTip, SensorOfRate):
    """An error of the tip sensor that depends on the rate of the reading."""

    title = "error of the tip sensor that depends on the rate of the reading"


class TipReadingGainSine(OfTip, SensorGainSine):
    """A sine in the gain of the tip sensor."""

    title = "a sine in the gain of the tip sensor"


class TipReadingSine(OfTip, SensorSine):
    """A sine in the readings of the tip sensor."""

    title = "a sine in the readings of the tip sensor"


class ThrustReadingOfRecoil(OfThrust, OtherPowers):
    """An error of the thrust sensor that is a function of the recoil."""

    title = "error of the thrust sensor that depends on the recoil"
    term_curve = OF_RECOIL

    def source(self):
        return RECOIL


class RecoilReadingOfThrust(OfRecoil, OtherPowers):
    """An error of the recoil sensor that is a function of the thrust."""

    title = "error of the recoil sensor that depends on the thrust"
    term_curve = OF_THRUST

    def source(self):
        return THRUST


class TipReadingOfPressure(OfTip, OtherPowers):
    """An error of the tip sensor that is a function of the pressures."""

    title = "error of the tip sensor that depends on the pressures"
    term_curve = OF_PRESSURE

    def source(self):
        return PRESSURE


class TipReadingOfRecoil(OfTip, OtherPowers):
    """An error of the tip sensor that is a function of the recoil."""

    title = "error of the tip sensor that depends on the recoil"
    term_curve = OF_RECOIL

    def source(self):
        return RECOIL


class PressureReadingOfTip(OfPressure, OtherPowers):
    """An error of the pressure sensors that is a function of the tip position."""

    title = "error of the pressure sensors that depends on the tip position"
    term_curve = OF_TIP

    def source(self):
        return TIP
