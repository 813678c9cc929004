"""Terms of the readings of each sensor."""

from abc import abstractmethod
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Curve, Instrument, Readings, parameter, shape_parameter
from slider_jax.effects.functions import (
    Basis,
    Drift,
    Powers,
    Sine,
    even_powers,
    mixed_powers,
    odd_powers,
)

WHY = "a sensor with an error as large as its scale is broken"
OF_TIME = Curve("time t", "s", "change divided by the scale", "-")
OF_PHASE = Curve("phase, the fraction of f t", "-", "change divided by the scale", "-")
OF_READING = Curve("reading divided by its scale", "-", "change divided by the scale", "-")
OF_PRESSURE = Curve("pressure divided by 100 kPa", "-", "change divided by the scale", "-")
OF_TIP = Curve("tip position divided by 20 mm", "-", "change divided by the scale", "-")
OF_GAIN = Curve("time t", "s", "change of the gain", "-")


class Sensor(NamedTuple):
    """Fields of `Readings` that one kind of sensor records, and the scale of its errors."""

    names: tuple[str, ...]
    scale: float
    """Typical reading, in the unit of the sensor. All parameters are divided by this scale."""

    def of(self, x: Readings) -> Array:
        """Returns the readings (fields, n) of the sensor, divided by its scale."""
        return jnp.stack([getattr(x, name) for name in self.names]) / self.scale


PRESSURE = Sensor(("p_front", "p_rear"), 100e3)
THRUST = Sensor(("thrust",), 0.2)
RECOIL = Sensor(("recoil",), 1.0)
TIP = Sensor(("tip",), 0.02)


class SensorTerm(Instrument):
    """y_read = y + s f, with a function f and the scale s of the sensor."""

    @abstractmethod
    def sensor(self) -> Sensor:
        """Returns the sensor whose readings change."""

    @abstractmethod
    def change(self, z: Array, true: Readings) -> Array:
        """Returns f for readings z (n,) of the sensor, divided by their scale."""

    def read(self, true):
        names, scale = self.sensor()
        series = {name: getattr(true, name) for name in names}
        return true._replace(
            **{name: y + scale * self.change(y / scale, true) for name, y in series.items()}
        )


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


class OtherPowers(SensorPowers):
    """f is a sum of q, |q| and q^2, where q is the reading of another sensor, the source.

    If the source has two fields, as the pressure sensors have, f is the sum over both fields.
    """

    def basis(self, z):
        return mixed_powers(z / self.scale)

    def change(self, z, true):
        return self.total(self.basis(self.state(true))).sum(axis=0)


class TimeTerm(Drift, SensorTerm):
    """f depends on a t + b t^2, with the time t of the trial."""

    a: Scalar = parameter(0.0, -1.0, 1.0, "1/s", WHY)
    """a, drift."""
    b: Scalar = parameter(0.0, -1.0, 1.0, "1/s^2", WHY)
    """b, change of the drift."""

    def state(self, x: Readings) -> Array:
        """Returns the time [s]."""
        return x.t

    def basis(self, z):
        return z, z**2


class SensorDrift(TimeTerm):
    """f = a t + b t^2."""

    term_curve = OF_TIME

    def change(self, z, true):
        return self.drift(true.t)


class SensorGainDrift(TimeTerm):
    """f = (a t + b t^2) y/s, with the reading y."""

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
    frequency: Scalar = shape_parameter(10.0, 0.1, 500.0, "Hz", "usual sample rates resolve these")
    """f, frequency of the most significant sine in the residual."""

    def change(self, z, true):
        return self.at(true.t)


class PressureReadingPowers(OfPressure, SensorOddPowers):
    """An error that is an odd function of the reading of the pressure sensors."""

    title = "nonlinearity of the pressure sensors"


class PressureReadingPowersBySign(OfPressure, SensorEvenPowers):
    """An error that is an even function of the reading of the pressure sensors."""

    title = "nonlinearity of the pressure sensors that depends on the sign"


class PressureReadingDrift(OfPressure, SensorDrift):
    """A drift of the pressure sensors."""

    title = "drift of the pressure sensors"


class PressureReadingGainDrift(OfPressure, SensorGainDrift):
    """A drift of the gain of the pressure sensors."""

    title = "drift of the gain of the pressure sensors"


class PressureReadingSine(OfPressure, SensorSine):
    """A sine in the readings of the pressure sensors."""

    title = "a sine in the readings of the pressure sensors"


class ThrustReadingPowers(OfThrust, SensorOddPowers):
    """An error that is an odd function of the reading of the thrust sensor."""

    title = "nonlinearity of the thrust sensor"


class ThrustReadingPowersBySign(OfThrust, SensorEvenPowers):
    """An error that is an even function of the reading of the thrust sensor."""

    title = "nonlinearity of the thrust sensor that depends on the sign"


class ThrustReadingDrift(OfThrust, SensorDrift):
    """A drift of the thrust sensor."""

    title = "drift of the thrust sensor"


class ThrustReadingGainDrift(OfThrust, SensorGainDrift):
    """A drift of the gain of the thrust sensor."""

    title = "drift of the gain of the thrust sensor"


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


class RecoilReadingPowersBySign(OfRecoil, SensorEvenPowers):
    """An error that is an even function of the reading of the recoil sensor."""

    title = "nonlinearity of the recoil sensor that depends on the sign"


class RecoilReadingDrift(OfRecoil, SensorDrift):
    """A drift of the recoil sensor."""

    title = "drift of the recoil sensor"


class RecoilReadingGainDrift(OfRecoil, SensorGainDrift):
    """A drift of the gain of the recoil sensor."""

    title = "drift of the gain of the recoil sensor"


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


class TipReadingPowersBySign(OfTip, SensorEvenPowers):
    """An error that is an even function of the reading of the tip sensor."""

    title = "nonlinearity of the tip sensor that depends on the sign"


class TipReadingDrift(OfTip, SensorDrift):
    """A drift of the tip sensor."""

    title = "drift of the tip sensor"


class TipReadingGainDrift(OfTip, SensorGainDrift):
    """A drift of the gain of the tip sensor."""

    title = "drift of the gain of the tip sensor"


class TipReadingSine(OfTip, SensorSine):
    """A sine in the readings of the tip sensor."""

    title = "a sine in the readings of the tip sensor"
