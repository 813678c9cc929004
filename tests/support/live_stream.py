"""A simulated robot that streams readings, with a finer grid than a twin and adjustable faults."""

from collections.abc import Iterator
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from calibration.measurements.synthetic import Sensors, slow_noise
from calibration.twin.stream import Samples
from slider_jax import observables as obs
from slider_jax.actuation import FirstOrderLag
from slider_jax.beam.grid import split_cells
from slider_jax.beam.parameters import Numerics, Scalar
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import at_rest
from slider_jax.effects import Flow
from slider_jax.experiment.load import to_model

RATE = 500.0
CHUNK = 250
"""Samples per call."""
SENSORS = Sensors(gain_drift=0.0)


class FrontFault(Flow):
    """A leak and a partly blocked valve on the positive side of the front chamber."""

    leak: Scalar = 0.0
    shut: Scalar = 0.0

    def rate(self, rate, x):
        here = (x.rear == 0.0) & (x.side > 0.0)
        rate = jnp.where(here & x.filling, (1.0 - self.shut) * rate, rate)
        return jnp.where(here, rate - self.leak * x.p / x.k, rate)


def _save(x):
    return jnp.stack([*x.chambers.p, obs.thrust(x), obs.recoil(x), obs.tip(x)])


def set_pressures(drive, t):
    """Returns the front and rear means since the previous reading, (2, n)."""

    def mean(wave):
        x = jax.vmap(wave.segment)(t - 1.0 / RATE, t)
        first, second = 0.5 * (x.a0 + x.a1), 0.5 * (x.b0 + x.b1)
        return RATE * (first * (x.t_break - x.t0) + second * (x.t1 - x.t_break))

    return jnp.stack([mean(wave) for wave in drive.waves])


def only(readings, keep):
    """Returns the kept readings; their set pressures are means since the previous kept reading."""
    runs = np.concatenate([[0], np.cumsum(keep)[:-1]])
    means = [np.bincount(runs, x) / np.bincount(runs) for x in readings.set_pressure]
    kept = int(keep.sum())
    return Samples(readings.t[keep], np.stack(means)[:, :kept], readings.measured[:, keep])


@eqx.filter_jit
def _advance(model, carry, t0, numerics):
    times = TimeGrid(jnp.asarray(1.0 / RATE), CHUNK, t0)
    out = rollout(model, times, _save, numerics, begin=carry, checkpoint=False)
    t = t0 + jnp.arange(1.0, CHUNK + 1.0) / RATE
    return out.final, t, set_pressures(model.drive, t), out.saved.T


class Streaming:
    """Streams the first trial of an experiment.

    A test may change `drive` (relative to the trial's amplitude), `leak`, `shut`, `k`, `K_Q`,
    `EI_tail` and `tail_length` during the stream. `tare` [N] is added to the forces.
    """

    def __init__(self, experiment, k, K_Q, nodes=61, seed=0):
        model = to_model(experiment, 0)
        self.k, self.K_Q = k, K_Q
        self.drive, self.leak, self.shut, self.tare = 1.0, 0.0, 0.0, 0.0
        robot = model.robot
        self.EI_tail, self.tail_length = float(robot.tail.EI), float(robot.tail.length)
        self.numerics = Numerics(*split_cells(nodes, self.tail_length, float(robot.body.length)))
        self._model, self._rng, self.t = model, np.random.default_rng(seed), 0.0
        self._carry = at_rest(self.model, self.numerics)

    @property
    def model(self):
        robot = replace(self._model.robot, K_Q=self.K_Q)
        waves = tuple(
            replace(w, amplitude=self.drive * w.amplitude) for w in self._model.drive.waves
        )
        model = replace(
            self._model,
            drive=replace(self._model.drive, waves=waves),
            robot=robot.with_tail(self.tail_length, self.EI_tail),
            pressure_law=FirstOrderLag(self.k),
            effects=(*self._model.effects, FrontFault(self.leak, self.shut)),
        )
        return jax.tree.map(lambda x: jnp.asarray(x, float), model)

    def readings(self) -> Samples:
        """Returns the next `CHUNK` readings."""
        self._carry, t, set_pressure, true = _advance(
            self.model, self._carry, jnp.asarray(self.t), self.numerics
        )
        assert bool(self._carry.ok)
        self.t = float(t[-1])
        t, true, rng = np.asarray(t), np.array(true), self._rng
        true[:2] += SENSORS.pressure_noise * rng.normal(size=(2, CHUNK))
        for row in (2, 3):
            slow = slow_noise(t, SENSORS.force_slow_time, rng)
            true[row] += self.tare + SENSORS.force_slow_noise * slow
            true[row] += SENSORS.force_noise * rng.normal(size=CHUNK)
        true[4] += SENSORS.tip_noise * rng.normal(size=CHUNK)
        true[4, np.arange(CHUNK) % 5 != 0] = np.nan
        return Samples(t, np.asarray(set_pressure), true)

    def run(self, seconds: float) -> Iterator[Samples]:
        """Yields the readings of the next `seconds`."""
        for _ in range(round(seconds * RATE / CHUNK)):
            yield self.readings()
