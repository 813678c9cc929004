"""Readings of the sensors in real time: instruments sample by sample, and sensor noise."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slider_jax.effects import Instrument, Readings
from slider_jax.experiment.schema import SensorsTable


class Past(NamedTuple):
    """The last inputs and readings of an instrument, oldest first."""

    shown: Readings
    """Inputs of the instrument."""
    read: Readings
    """Readings of the instrument."""


def constant_past(effect: Instrument, first: Readings, h: float, samples: int) -> Past:
    """Return the past of an instrument with constant input: `samples` samples, `h` [s] apart."""
    held = jax.tree.map(lambda x: jnp.broadcast_to(x, (samples,)), first)
    shown = held._replace(t=first.t + h * jnp.arange(1.0 - samples, 1.0))
    return Past(shown, effect.read(shown))


def read_now(effect: Instrument, past: Past, true: Readings) -> tuple[Readings, Past]:
    """Return the reading of the next input `true` (scalars), and the new past."""
    shown = jax.tree.map(_append, past.shown, true)
    now = effect.read_sample(shown, past.read)
    return now, Past(shown, jax.tree.map(_append, past.read, now))


def _append(series: Array, x: Array) -> Array:
    return jnp.concatenate([series[1:], x[None]])


class SensorReading(NamedTuple):
    """Readings of the sensors at `t` [s], without noise; `SensorNoise` adds the noise."""

    t: float
    pressures: tuple[float, float, float, float]
    """Gauge pressures [Pa] of the chambers: front left, front right, rear left, rear right."""
    p_front: float
    """Signed pressure [Pa], left minus right, as in the model and its columns; also `p_rear`."""
    p_rear: float
    thrust_N: float
    recoil_N: float
    tip_m: float
    ok: bool
    """False after a failed step; the reading is then the last valid one."""


class SensorNoise:
    """Adds white noise to all readings, and slow noise and a constant tare to the forces.

    The slow noise is an Ornstein-Uhlenbeck process with the standard deviation `force_slow_noise`
    and the correlation time `force_slow_time`. `begin` samples a new tare. `pressure_noise` applies
    to a segment's signed pressure; each of its two chambers has 1/sqrt(2) of it.
    """

    def __init__(self, sensors: SensorsTable, seed: int):
        self._sensors = sensors
        self._rng = np.random.default_rng(seed)
        self.begin()

    def begin(self) -> None:
        """Start a new trial: sample the tare and the slow noise again."""
        self._tare = self._sensors.force_tare * self._rng.normal(size=2)
        self._slow = self._rng.normal(size=2)
        self._t: float | None = None

    def add(self, x: SensorReading) -> SensorReading:
        """Return the reading with noise. Times must not decrease from call to call."""
        sensors, rng = self._sensors, self._rng
        before = x.t if self._t is None else self._t
        keep = np.exp(-(x.t - before) / sensors.force_slow_time)
        self._t = x.t
        self._slow = keep * self._slow + np.sqrt(1.0 - keep**2) * rng.normal(size=2)
        each = sensors.pressure_noise / np.sqrt(2.0)
        pressures = (p + each * rng.normal() for p in x.pressures)
        front_left, front_right, rear_left, rear_right = pressures
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
