"""Noise of an experiment's `[sensors]`, sample by sample."""

import numpy as np

from slider_jax.experiment.schema import SensorsTable
from slider_jax.realtime.plant import SensorReading


class SensorNoise:
    """Adds noise to readings: white on all, slow and a tare on the forces.

    The slow part is an Ornstein-Uhlenbeck process of `force_slow_noise`, correlated over
    `force_slow_time`; the tare is constant until `begin`. `pressure_noise` is that of a segment's
    signed pressure: each of its two chambers has 1/sqrt(2) of it.
    """

    def __init__(self, sensors: SensorsTable, seed: int):
        self._sensors = sensors
        self._rng = np.random.default_rng(seed)
        self.begin()

    def begin(self) -> None:
        """A new trial: another tare, the slow noise drawn anew."""
        self._tare = self._sensors.force_tare * self._rng.normal(size=2)
        self._slow = self._rng.normal(size=2)
        self._t: float | None = None

    def add(self, x: SensorReading) -> SensorReading:
        """The reading with noise; its time must not fall from call to call."""
        sensors, rng = self._sensors, self._rng
        before = x.t if self._t is None else self._t
        keep = np.exp(-(x.t - before) / sensors.force_slow_time)
        self._t = x.t
        self._slow = keep * self._slow + np.sqrt(1.0 - keep**2) * rng.normal(size=2)
        each = sensors.pressure_noise / np.sqrt(2.0)
        front_left, front_right, rear_left, rear_right = (
            p + each * rng.normal() for p in x.pressures
        )
        force = self._tare + sensors.force_slow_noise * self._slow
        force = force + sensors.force_noise * rng.normal(size=2)
        return x._replace(
            pressures=(front_left, front_right, rear_left, rear_right),
            p_front=front_left - front_right,
            p_rear=rear_left - rear_right,
            thrust_N=x.thrust_N + float(force[0]),
            recoil_N=x.recoil_N + float(force[1]),
            tip_m=x.tip_m + sensors.tip_noise * rng.normal(),
        )
