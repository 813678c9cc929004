"""The rig's pressure logs as trials: what one chamber would read for a parameter vector.

Every log runs freely from its first measured sample and sees only the command after it.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from calibration.inference.noise import channel_noise
from calibration.inference.problem import AbstractProblem
from calibration.measurements.records import Record
from calibration.model.extended import Extended, candidates, parameters
from calibration.model.predict import DIRECTIONS
from calibration.pressure_logs.read import ManifoldLog
from slider_jax.actuation import Recorded
from slider_jax.beam.parameters import Robot
from slider_jax.channels import CHANNELS, recorded, row_of
from slider_jax.dynamics.model import Drive
from slider_jax.dynamics.pressures import chamber_history, start_chambers
from slider_jax.effects import Command, Flow, Instrument, Readings
from slider_jax.effects.library import LIBRARY
from slider_jax.experiment.load import Experiment, assemble, conditions
from slider_jax.experiment.prepare import prepare
from slider_jax.experiment.schema import SensorsTable
from slider_jax.paper import PRESSURE_LAG

CHANNEL = "p_front"
"""Channel that a log's one pressure is taken for."""
FREE = ("k",)
"""Parameters of the base model that a pressure log can show."""


def log_candidates() -> list[str]:
    """Effects that a log's pressure could show: of command, flow and pressure sensor."""
    return [
        name
        for name in candidates()
        if issubclass(LIBRARY[name], (Command, Flow, Instrument))
        and "pressure" in LIBRARY[name].sensors
        and not LIBRARY[name].rear_only
    ]


def log_experiment(log: ManifoldLog, model: Path | None, numerics: dict[str, float]) -> Experiment:
    """The built-in robot, C_d and m_a on the paper's ramp at the log's frequency, overridden."""
    robot = asdict(Robot())
    K_Q = robot.pop("K_Q")
    content = {
        "name": log.path.stem,
        "robot": robot,
        "parameters": {"force_coefficients": "ramp", "k": PRESSURE_LAG, "K_Q": K_Q},
        "numerics": numerics,
        "trials": [
            {
                "file": f"{log.path.stem}.csv",
                "waveform": "sine",
                "frequency": log.frequency,
                "amplitude": float(max(np.abs(log.command_Pa).max(), 1e3)),
                "duration": float(log.t[-1]),
            }
        ],
    }
    return assemble(content, str(log.path), log.path.parent, model)


def log_record(log: ManifoldLog, experiment: Experiment) -> Record:
    """A log as a measured trial whose only channel is `CHANNEL`."""
    values = np.full((len(CHANNELS), len(log.t)), np.nan)
    values[row_of(CHANNEL)] = log.pressure_Pa
    return Record(experiment.trials[0], log.t, values)


class LogDrive(eqx.Module):
    """Commands of logs on the grid of the longest one's samples, from measured starts."""

    at: Float[Array, "logs n"]
    command: Float[Array, "logs n"]
    start: Float[Array, " logs"]


@final
@dataclass(frozen=True, kw_only=True)
class PressureLogProblem(AbstractProblem):
    """Pressure logs as trials. A simulation omits the effects that are at their null."""

    logs: list[ManifoldLog]
    base: Extended
    drive: LogDrive

    @classmethod
    def of_logs(cls, logs: Sequence[ManifoldLog], names: Sequence[str]) -> "PressureLogProblem":
        """Returns the problem of logs for the extended model with the effects `names`."""
        experiments = [log_experiment(log, None, {}) for log in logs]
        found = [log_record(log, x) for log, x in zip(logs, experiments, strict=True)]
        row = row_of(CHANNEL)
        noise = {
            (i, CHANNEL): channel_noise(SensorsTable(), CHANNEL, r.values[row])
            for i, r in enumerate(found)
        }
        n = max(round(log.t[-1] / log.period) for log in logs) + 1
        at = np.stack([log.period * np.arange(n) for log in logs])
        command = [np.interp(t, log.t, log.command_Pa) for t, log in zip(at, logs, strict=True)]
        drive = LogDrive(
            jnp.asarray(at),
            jnp.asarray(np.stack(command)),
            jnp.asarray([log.pressure_Pa[0] for log in logs]),
        )
        first = prepare(experiments[0], sample_times=logs[0].t, as_meant=True)
        taken = {n: jnp.asarray(x) for n, x in conditions(experiments[0], first.trial).items()}
        base = Extended(first.model, taken, tuple(names), first.channels)
        return cls(
            records=found,
            channels=(CHANNEL,),
            noise=noise,
            logs=list(logs),
            base=base,
            drive=drive,
        )

    def spans(self) -> None:
        """Returns None: a log has no initial swing."""

    def _predict(self, theta: np.ndarray) -> list[np.ndarray]:
        moved = self._moved(theta)
        return self._cut(
            np.asarray(_readings(self._with(moved), self._of(theta, moved), self.drive))
        )

    def _tangents(self, theta: np.ndarray, directions: np.ndarray) -> list[np.ndarray]:
        along = np.any(np.asarray(directions) != 0.0, axis=0)
        moved = self._moved(theta, along)
        extended, at = self._with(moved), self._of(theta, moved)
        short = np.stack([self._of(d, moved) for d in directions])
        padded = np.zeros((-(-len(short) // DIRECTIONS) * DIRECTIONS, short.shape[1]))
        padded[: len(short)] = short
        blocks = [
            np.asarray(_along(extended, at, self.drive, jnp.asarray(padded[i : i + DIRECTIONS])))
            for i in range(0, len(padded), DIRECTIONS)
        ]
        series = np.concatenate(blocks)[: len(short)]
        each = [self._cut(x) for x in series]
        return [np.stack(x) for x in zip(*each, strict=True)]

    def _secants(self, theta: np.ndarray, others: Sequence[np.ndarray]) -> list[np.ndarray]:
        here = self.predict(theta)
        there = [self.predict(other) for other in others]
        return [np.stack([x[i] - here[i] for x in there]) for i in range(len(here))]

    def _moved(self, theta: np.ndarray, along: np.ndarray | None = None) -> tuple[str, ...]:
        """Effects that the vector moves off their null, or that a direction would."""
        found = dict.fromkeys(
            p.effect
            for i, p in enumerate(parameters(self.base.effects))
            if p.effect and (theta[i] != p.prior.null or (along is not None and along[i]))
        )
        return tuple(found)

    def _with(self, names: tuple[str, ...]) -> Extended:
        return replace(self.base, effects=names)

    def _of(self, theta: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
        """Entries of the vector that are of the base model or of `names`."""
        entries = parameters(self.base.effects)
        return np.array(
            [x for x, p in zip(theta, entries, strict=True) if p.effect in ("", *names)]
        )

    def _cut(self, series: np.ndarray) -> list[np.ndarray]:
        """(channels, samples) of every log from (logs, n)."""
        found = []
        for log, x in zip(self.logs, series, strict=True):
            values = np.full((len(CHANNELS), len(log.t)), np.nan)
            values[row_of(CHANNEL)] = x[np.round(log.t / log.period).astype(int)]
            found.append(values)
        return found


def _read(extended: Extended, theta, drive: LogDrive):
    """What the sensor reads (logs, n) [Pa]."""
    model = extended.at(theta)

    def one(at, command, start):
        wave = Recorded(at, command)
        driven = replace(model, drive=Drive(wave, wave, start, start))
        begin = start_chambers(driven)
        p = jnp.concatenate([begin.p[None], chamber_history(driven, begin, at).p])
        zero = jnp.zeros_like(at)
        return recorded(model.effects, Readings(at, *p.T, zero, zero, zero)).p_front

    return jax.vmap(one)(drive.at, drive.command, drive.start)


@eqx.filter_jit
def _readings(extended: Extended, theta, drive: LogDrive):
    return _read(extended, theta, drive)


@eqx.filter_jit
def _along(extended: Extended, theta, drive: LogDrive, directions):
    def value(theta):
        return _read(extended, theta, drive)

    return jax.vmap(lambda d: jax.jvp(value, (theta,), (d,))[1])(directions)
