"""Treats the rig's pressure logs as trials, and predicts the pressure of one chamber.

The prediction starts at the first measured pressure and then depends only on the command.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
from calibration.model.compiled import by_directions, on_all_cores
from calibration.model.extended import ExtendedModel, candidate_effects, model_parameters
from calibration.model.predict import recorded_pressures
from calibration.pressure_logs.read import ManifoldLog
from slider_jax.actuation import Recorded
from slider_jax.beam.parameters import SLIDER
from slider_jax.dynamics.model import Drive
from slider_jax.effects import Command, Flow, Instrument
from slider_jax.effects.library import LIBRARY
from slider_jax.effects.pneumatics.drive_clock import DriveClock
from slider_jax.experiment.load import Experiment, assemble, trial_conditions
from slider_jax.experiment.prepare import prepare
from slider_jax.experiment.sensor_tables import SensorsTable
from slider_jax.paper import PRESSURE_LAG

CHANNEL = "p_front"
"""Channel of the extended model that predicts the single pressure of a log."""
FREE = ("k",)
"""Parameters of the base model that a pressure log can identify."""
LONG_SHARE = 0.5
"""Logs longer than this fraction of the longest log are one group, and the other logs another. Each
group is a batch on one core. In one batch, short logs would be as costly as the longest log."""

SENSORS = SensorsTable(pressure_gain=0.0)
"""The same sensor records all logs of a sweep, so its gain does not differ between logs."""


def log_candidates() -> list[str]:
    """Returns the names of the effects that change the measured pressure of the front chamber.

    `drive_clock` is not among them: the same clock records the command and the pressure.
    """
    return [
        name
        for name in candidate_effects()
        if issubclass(LIBRARY[name], (Command, Flow, Instrument))
        and "pressure" in LIBRARY[name].sensors
        and not LIBRARY[name].rear_only
        and LIBRARY[name] is not DriveClock
    ]


def log_experiment(log: ManifoldLog, model: Path | None, numerics: dict[str, float]) -> Experiment:
    """Returns an experiment with the built-in robot and one trial at the log's frequency.

    C_d and m_a have the paper's values. The tables of the file `model` override built-in tables.
    """
    robot = dict(SLIDER)
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


def log_records(log: ManifoldLog) -> list[Record]:
    """Returns the two halves of a log as measured trials with `CHANNEL` as the only channel.

    Cross-validation then leaves out half of a log. A whole log may be the only one that determines
    a parameter, for example a natural frequency near the log's frequency.
    """
    experiment, found = log_experiment(log, None, {}), []
    trial, channels = experiment.trials[0], experiment.channels
    halves = np.array_split(np.arange(len(log.t)), 2)
    for name, part in zip(("first", "second"), halves, strict=True):
        values = np.full((len(channels), len(part)), np.nan)
        values[channels.row(CHANNEL)] = log.pressure_Pa[part]
        named = trial.model_copy(update={"file": f"{log.path.name}, {name} half"})
        found.append(Record(named, log.t[part], values, channels))
    return found


class LogDrive(eqx.Module):
    """Commands [Pa] of logs at the times `at` [s], and the first measured pressures `start` [Pa].

    Shorter logs are extended, so that all logs of a group have as many samples as its longest log.
    """

    at: Float[Array, "logs n"]
    command: Float[Array, "logs n"]
    start: Float[Array, " logs"]


@final
@dataclass(frozen=True, kw_only=True)
class PressureLogProblem(AbstractProblem):
    """Pressure logs as trials: records 2 i and 2 i + 1 are the halves of log i.

    To save time, a simulation omits effects that are at their null.
    """

    logs: list[ManifoldLog]
    base: ExtendedModel
    drives: list[tuple[list[int], LogDrive]]
    """Groups of logs with similar durations: their indices, and their drive."""

    @classmethod
    def of_logs(cls, logs: Sequence[ManifoldLog], names: Sequence[str]) -> "PressureLogProblem":
        """Returns the problem of fitting `logs` with the base model and the effects `names`."""
        records = [record for log in logs for record in log_records(log)]
        noise = {
            (i, CHANNEL): channel_noise(SENSORS, r.channels[CHANNEL], r.values[r.row(CHANNEL)])
            for i, r in enumerate(records)
        }
        long = [_samples(log) > LONG_SHARE * max(map(_samples, logs)) for log in logs]
        groups = [[i for i, x in enumerate(long) if x is kind] for kind in (True, False)]
        drives = [(group, _drive([logs[i] for i in group])) for group in groups if group]
        experiment = log_experiment(logs[0], None, {})
        first = prepare(experiment, sample_times=logs[0].t, declared_drive=True)
        taken = {n: jnp.asarray(x) for n, x in trial_conditions(experiment, first.trial).items()}
        base = ExtendedModel(first.model, taken, tuple(names), first.channels)
        return cls(
            records=records,
            channels=(CHANNEL,),
            noise=noise,
            logs=list(logs),
            base=base,
            drives=drives,
        )

    def spans(self) -> None:
        """Returns None, because a log contains no motion of the robot."""

    def _predict(self, theta: np.ndarray) -> list[np.ndarray]:
        return [x[0] for x in self._coarse([theta])]

    def _coarse(self, thetas: Sequence[np.ndarray]) -> list[np.ndarray]:
        rows = np.stack(thetas)
        extended = self._moved(rows, np.zeros(rows.shape[1], bool))
        short = self._entries(rows, extended)
        return self._each(lambda drive, rows: _readings(extended, rows, drive), short)

    def _tangents(self, theta: np.ndarray, directions: np.ndarray) -> list[np.ndarray]:
        along = np.any(np.asarray(directions) != 0.0, axis=0)
        extended = self._moved(theta[None], along)
        at, short = (self._entries(x, extended) for x in (theta, np.asarray(directions)))
        moving = np.flatnonzero(np.any(directions != 0.0, axis=1))
        some = self._each(lambda drive, rows: _along(extended, at, drive, rows), short[moving])
        found = [np.zeros((len(directions), *x.shape[1:])) for x in some]
        for x, rows in zip(found, some, strict=True):
            x[moving] = rows
        return found

    def _each(
        self, run: Callable[[LogDrive, np.ndarray], Array], rows: np.ndarray
    ) -> list[np.ndarray]:
        """Returns `run(drive, rows)` as arrays (rows, channels, samples) of every record."""
        found = [np.full((len(rows), *r.values.shape), np.nan) for r in self.records]

        def one(job: tuple[list[int], LogDrive]) -> None:
            group, drive = job
            for here, series in by_directions(lambda block: run(drive, block), rows):
                for place, i in enumerate(group):
                    for half in (2 * i, 2 * i + 1):
                        at = np.round(self.records[half].t / self.logs[i].period).astype(int)
                        found[half][here, self.all_channels.row(CHANNEL)] = series[:, place, at]

        on_all_cores(one, self.drives)
        return found

    def _moved(self, thetas: np.ndarray, along: np.ndarray) -> ExtendedModel:
        """Returns the model with the effects that are not at null in `thetas` or that move `along`.

        `thetas` has the shape (k, entries), and `along` (entries,) contains truth values.
        """
        found = dict.fromkeys(
            p.effect
            for i, p in enumerate(model_parameters(self.base.effects))
            if p.effect and (np.any(thetas[:, i] != p.prior.null) or along[i])
        )
        return replace(self.base, effects=tuple(found))

    def _entries(self, rows: np.ndarray, extended: ExtendedModel) -> np.ndarray:
        """Returns the last axis of `rows` for the base model and the effects of `extended`."""
        names = ("", *extended.effects)
        return rows[..., [p.effect in names for p in model_parameters(self.base.effects)]]


def _samples(log: ManifoldLog) -> int:
    return round(log.t[-1] / log.period) + 1


def _drive(logs: Sequence[ManifoldLog]) -> LogDrive:
    at = np.stack([log.period * np.arange(max(map(_samples, logs))) for log in logs])
    command = [np.interp(t, log.t, log.command_Pa) for t, log in zip(at, logs, strict=True)]
    start = [log.pressure_Pa[0] for log in logs]
    return LogDrive(jnp.asarray(at), jnp.asarray(np.stack(command)), jnp.asarray(start))


def _read(extended: ExtendedModel, theta, drive: LogDrive):
    """Returns the predicted readings (logs, n) [Pa] of the pressure sensor."""
    model = extended.at(theta)

    def one(at, command, start):
        wave = Recorded(at, command)
        driven = replace(model, drive=Drive((wave,) * len(model.drive.waves), start))
        return recorded_pressures(driven, at)[0]

    return jax.vmap(one)(drive.at, drive.command, drive.start)


@eqx.filter_jit
def _readings(extended: ExtendedModel, thetas, drive: LogDrive):
    return jax.vmap(lambda theta: _read(extended, theta, drive))(thetas)


@eqx.filter_jit
def _along(extended: ExtendedModel, theta, drive: LogDrive, directions):
    def tangent(direction):
        return jax.jvp(lambda x: _read(extended, x, drive), (theta,), (direction,))[1]

    return jax.vmap(tangent)(directions)
