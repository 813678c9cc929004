"""Treats the rig's pressure logs as trials, and predicts the pressure of one chamber.

The prediction starts at the first measured pressure and then depends only on the command.
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
from calibration.model.compiled import by_directions
from calibration.model.extended import ExtendedModel, candidate_effects, model_parameters
from calibration.model.predict import recorded_pressures
from calibration.pressure_logs.read import ManifoldLog
from slider_jax.actuation import Recorded
from slider_jax.beam.parameters import Robot
from slider_jax.channels import CHANNELS, row_of
from slider_jax.dynamics.model import Drive
from slider_jax.effects import Command, Flow, Instrument
from slider_jax.effects.library import LIBRARY
from slider_jax.experiment.load import Experiment, assemble, trial_conditions
from slider_jax.experiment.prepare import prepare
from slider_jax.experiment.schema import SensorsTable
from slider_jax.paper import PRESSURE_LAG

CHANNEL = "p_front"
"""Channel of the extended model that predicts the single pressure of a log."""
FREE = ("k",)
"""Parameters of the base model that a pressure log can identify."""


def log_candidates() -> list[str]:
    """Returns the names of the effects that change the measured pressure of the front chamber."""
    return [
        name
        for name in candidate_effects()
        if issubclass(LIBRARY[name], (Command, Flow, Instrument))
        and "pressure" in LIBRARY[name].sensors
        and not LIBRARY[name].rear_only
    ]


def log_experiment(log: ManifoldLog, model: Path | None, numerics: dict[str, float]) -> Experiment:
    """Returns an experiment with the built-in robot and one trial at the log's frequency.

    C_d and m_a have the paper's values. The tables of the file `model` override built-in tables.
    """
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
    """Returns a log as a measured trial with `CHANNEL` as the only channel."""
    values = np.full((len(CHANNELS), len(log.t)), np.nan)
    values[row_of(CHANNEL)] = log.pressure_Pa
    return Record(experiment.trials[0], log.t, values)


class LogDrive(eqx.Module):
    """Commands [Pa] of logs at the times `at` [s], and the first measured pressures `start` [Pa].

    Shorter logs are extended, so that all logs have as many samples as the longest log.
    """

    at: Float[Array, "logs n"]
    command: Float[Array, "logs n"]
    start: Float[Array, " logs"]


@final
@dataclass(frozen=True, kw_only=True)
class PressureLogProblem(AbstractProblem):
    """Pressure logs as trials. To save time, a simulation omits effects that are at their null."""

    logs: list[ManifoldLog]
    base: ExtendedModel
    drive: LogDrive

    @classmethod
    def of_logs(cls, logs: Sequence[ManifoldLog], names: Sequence[str]) -> "PressureLogProblem":
        """Returns the problem of fitting `logs` with the base model and the effects `names`."""
        experiments = [log_experiment(log, None, {}) for log in logs]
        records = [log_record(log, x) for log, x in zip(logs, experiments, strict=True)]
        row = row_of(CHANNEL)
        noise = {
            (i, CHANNEL): channel_noise(SensorsTable(), CHANNEL, r.values[row])
            for i, r in enumerate(records)
        }
        n = max(round(log.t[-1] / log.period) for log in logs) + 1
        at = np.stack([log.period * np.arange(n) for log in logs])
        command = [np.interp(t, log.t, log.command_Pa) for t, log in zip(at, logs, strict=True)]
        drive = LogDrive(
            jnp.asarray(at),
            jnp.asarray(np.stack(command)),
            jnp.asarray([log.pressure_Pa[0] for log in logs]),
        )
        first = prepare(experiments[0], sample_times=logs[0].t, declared_drive=True)
        taken = {
            n: jnp.asarray(x) for n, x in trial_conditions(experiments[0], first.trial).items()
        }
        base = ExtendedModel(first.model, taken, tuple(names), first.channels)
        return cls(
            records=records,
            channels=(CHANNEL,),
            noise=noise,
            logs=list(logs),
            base=base,
            drive=drive,
        )

    def spans(self) -> None:
        """Returns None, because a log contains no motion of the robot."""

    def _predict(self, theta: np.ndarray) -> list[np.ndarray]:
        extended = self._moved(theta, np.zeros(len(theta), bool))
        at = self._entries(theta, extended)
        return self._at_samples(np.asarray(_readings(extended, at, self.drive)))

    def _tangents(self, theta: np.ndarray, directions: np.ndarray) -> list[np.ndarray]:
        along = np.any(np.asarray(directions) != 0.0, axis=0)
        extended = self._moved(theta, along)
        at = self._entries(theta, extended)
        short = np.stack([self._entries(d, extended) for d in directions])
        series = by_directions(lambda d: _along(extended, at, self.drive, d), short)
        each = [self._at_samples(x) for x in series]
        return [np.stack(x) for x in zip(*each, strict=True)]

    def _coarse(self, thetas: Sequence[np.ndarray]) -> list[np.ndarray]:
        each = [self.predict(theta) for theta in thetas]
        return [np.stack(x) for x in zip(*each, strict=True)]

    def _moved(self, theta: np.ndarray, along: np.ndarray) -> ExtendedModel:
        """Returns the model with only the effects that are not at null or that `along` marks."""
        found = dict.fromkeys(
            p.effect
            for i, p in enumerate(model_parameters(self.base.effects))
            if p.effect and (theta[i] != p.prior.null or along[i])
        )
        return replace(self.base, effects=tuple(found))

    def _entries(self, theta: np.ndarray, extended: ExtendedModel) -> np.ndarray:
        """Returns the entries of `theta` for the base model and the effects of `extended`."""
        entries, names = model_parameters(self.base.effects), ("", *extended.effects)
        return np.array([x for x, p in zip(theta, entries, strict=True) if p.effect in names])

    def _at_samples(self, series: np.ndarray) -> list[np.ndarray]:
        """Returns the readings (channels, samples) of every log from the `series` (logs, n)."""
        found = []
        for log, x in zip(self.logs, series, strict=True):
            values = np.full((len(CHANNELS), len(log.t)), np.nan)
            values[row_of(CHANNEL)] = x[np.round(log.t / log.period).astype(int)]
            found.append(values)
        return found


def _read(extended: ExtendedModel, theta, drive: LogDrive):
    """Returns the predicted readings (logs, n) [Pa] of the pressure sensor."""
    model = extended.at(theta)

    def one(at, command, start):
        wave = Recorded(at, command)
        driven = replace(model, drive=Drive(wave, wave, start, start))
        return recorded_pressures(driven, at)[0]

    return jax.vmap(one)(drive.at, drive.command, drive.start)


_readings = eqx.filter_jit(_read)


@eqx.filter_jit
def _along(extended: ExtendedModel, theta, drive: LogDrive, directions):
    def tangent(direction):
        return jax.jvp(lambda x: _read(extended, x, drive), (theta,), (direction,))[1]

    return jax.vmap(tangent)(directions)
