"""Terms of the readings of each sensor."""

import math
from abc import abstractmethod
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Curve, Instrument, Readings, parameter, shape_parameter
from slider_jax.effects.functions import magnitude

CORNER = 0.02
"""Width of the smooth corner of |y|, as a fraction of the sensor's scale."""
WHY = "a sensor with an error as large as its scale is broken"


class Sensor(NamedTuple):
    """Fields of `Readings` that one kind of sensor records, and the scale of its errors."""

    names: tuple[str, ...]
    scale: float
    """Typical reading, in the unit of the sensor. All parameters are divided by this scale."""


PRESSURE = Sensor(("p_front", "p_rear"), 100e3)
THRUST = Sensor(("thrust",), 0.2)
RECOIL = Sensor(("recoil",), 1.0)
TIP = Sensor(("tip",), 0.02)
OF_TIME = ("time t", "s", "change divided by the scale", "-")
OF_READING = ("reading divided by its scale", "-", "change divided by the scale", "-")


def _changed(true: Readings, sensor: Sensor, change) -> Readings:
    """Returns the readings with scale times `change(y)` added to each series y of the sensor."""
    series = {name: getattr(true, name) for name in sensor.names}
    return true._replace(**{name: y + sensor.scale * change(y) for name, y in series.items()})


class SensorPowers(Instrument):
    """y_read = y + s (a |z| + b z |z| + c z^3), with z = y/s and the scale s of the sensor."""

    a: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY)
    """a, part with the same sign for positive and negative readings."""
    b: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY)
    """b, quadratic part."""
    c: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY)
    """c, cubic part."""

    @abstractmethod
    def sensor(self) -> Sensor:
        """Returns the sensor whose readings change."""

    def state(self, x: Readings) -> Array:
        """Returns the readings divided by their scale."""
        sensor = self.sensor()
        return jnp.stack([getattr(x, name) for name in sensor.names]) / sensor.scale

    def basis(self, z: Array) -> Float[Array, "3 ..."]:
        """Returns the basis functions at the reading z."""
        return jnp.stack([magnitude(z, CORNER) - CORNER, z * jnp.abs(z), z**3])

    def read(self, true):
        def change(y):
            a, b, c = self.basis(y / self.sensor().scale)
            return self.a * a + self.b * b + self.c * c

        return _changed(true, self.sensor(), change)


class SensorDrift(Instrument):
    """y_read = y + s (a t + b t^2), with the time t of the trial and the scale s of the sensor."""

    a: Scalar = parameter(0.0, -1.0, 1.0, "1/s", WHY)
    """a, drift."""
    b: Scalar = parameter(0.0, -1.0, 1.0, "1/s^2", WHY)
    """b, change of the drift."""

    @abstractmethod
    def sensor(self) -> Sensor:
        """Returns the sensor whose readings change."""

    def state(self, x: Readings) -> Array:
        """Returns the time [s]."""
        return x.t

    def basis(self, z: Array) -> Float[Array, "2 ..."]:
        """Returns the basis functions at the time z."""
        return jnp.stack([z, z**2])

    def read(self, true):
        a, b = self.basis(true.t)
        return _changed(true, self.sensor(), lambda y: self.a * a + self.b * b)


class SensorSine(Instrument):
    """y_read = y + s (a sin(2 pi f t) + b cos(2 pi f t)), with the scale s of the sensor."""

    a: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY)
    """a, amplitude of the sine."""
    b: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY)
    """b, amplitude of the cosine."""
    frequency: Scalar = shape_parameter(10.0, 0.1, 500.0, "Hz", "usual sample rates resolve these")
    """f, frequency of the largest sine in the residual."""

    @abstractmethod
    def sensor(self) -> Sensor:
        """Returns the sensor whose readings change."""

    def state(self, x: Readings) -> Array:
        """Returns the time [s]."""
        return x.t

    def basis(self, z: Array) -> Float[Array, "2 ..."]:
        """Returns the basis functions at the time z."""
        angle = 2.0 * math.pi * self.frequency * z
        return jnp.stack([jnp.sin(angle), jnp.cos(angle)])

    def read(self, true):
        a, b = self.basis(true.t)
        return _changed(true, self.sensor(), lambda y: self.a * a + self.b * b)


class PressureReadingPowers(SensorPowers):
    """A nonlinear characteristic of the pressure sensors."""

    title = "nonlinearity of the pressure sensors"
    sensors = ("pressure",)
    term_curve = Curve(*OF_READING)

    def sensor(self):
        return PRESSURE


class PressureReadingDrift(SensorDrift):
    """A drift of the pressure sensors."""

    title = "drift of the pressure sensors"
    sensors = ("pressure",)
    term_curve = Curve(*OF_TIME)

    def sensor(self):
        return PRESSURE


class PressureReadingSine(SensorSine):
    """A sine in the readings of the pressure sensors."""

    title = "a sine in the readings of the pressure sensors"
    sensors = ("pressure",)
    term_curve = Curve(*OF_TIME)

    def sensor(self):
        return PRESSURE


class ThrustReadingPowers(SensorPowers):
    """A nonlinear characteristic of the thrust sensor."""

    title = "nonlinearity of the thrust sensor"
    sensors = ("thrust",)
    term_curve = Curve(*OF_READING)

    def sensor(self):
        return THRUST


class ThrustReadingDrift(SensorDrift):
    """A drift of the thrust sensor."""

    title = "drift of the thrust sensor"
    sensors = ("thrust",)
    term_curve = Curve(*OF_TIME)

    def sensor(self):
        return THRUST


class ThrustReadingSine(SensorSine):
    """A sine in the readings of the thrust sensor."""

    title = "a sine in the readings of the thrust sensor"
    sensors = ("thrust",)
    term_curve = Curve(*OF_TIME)

    def sensor(self):
        return THRUST


class RecoilReadingPowers(SensorPowers):
    """A nonlinear characteristic of the recoil sensor."""

    title = "nonlinearity of the recoil sensor"
    sensors = ("recoil",)
    term_curve = Curve(*OF_READING)

    def sensor(self):
        return RECOIL


class RecoilReadingDrift(SensorDrift):
    """A drift of the recoil sensor."""

    title = "drift of the recoil sensor"
    sensors = ("recoil",)
    term_curve = Curve(*OF_TIME)

    def sensor(self):
        return RECOIL


class RecoilReadingSine(SensorSine):
    """A sine in the readings of the recoil sensor."""

    title = "a sine in the readings of the recoil sensor"
    sensors = ("recoil",)
    term_curve = Curve(*OF_TIME)

    def sensor(self):
        return RECOIL


class TipReadingPowers(SensorPowers):
    """A nonlinear characteristic of the tip sensor."""

    title = "nonlinearity of the tip sensor"
    sensors = ("tip",)
    term_curve = Curve(*OF_READING)

    def sensor(self):
        return TIP


class TipReadingDrift(SensorDrift):
    """A drift of the tip sensor."""

    title = "drift of the tip sensor"
    sensors = ("tip",)
    term_curve = Curve(*OF_TIME)

    def sensor(self):
        return TIP


class TipReadingSine(SensorSine):
    """A sine in the readings of the tip sensor."""

    title = "a sine in the readings of the tip sensor"
    sensors = ("tip",)
    term_curve = Curve(*OF_TIME)

    def sensor(self):
        return TIP
