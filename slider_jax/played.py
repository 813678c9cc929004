"""A trial's drive as it was played: which set pressures the valves were told, and when.

A computer beside a tank is late by what its other work, the line and the manifold's own loop make
of it, differently at every edge. A millisecond at an edge of 400 kPa is some kilopascal for as long
as the chamber fills, many times the sensors' noise, and to be had for nothing where the manifold
says what it followed.
"""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from slider_jax.actuation import Held
from slider_jax.csv_file import read_csv
from slider_jax.errors import InputError
from slider_jax.experiment import Experiment
from slider_jax.model import Drive, Model
from slider_jax.schema import Trial

COLUMNS = ("t_s", "set_front_Pa", "set_rear_Pa")
"""Each row's signed set pressures hold from its time on; the last row is the trial's end."""
LEAST_ROWS = 64
"""Changes are padded to a power of two from here on: trials share compiled programs."""


def played_file(experiment: Experiment, trial: Trial) -> Path:
    """Where a trial's drive as it was played lies, if it was recorded: NAME.played.csv."""
    return experiment.folder / f"{Path(trial.file).stem}.played.csv"


def changes(experiment: Experiment, trial: Trial) -> dict[str, np.ndarray] | None:
    """`COLUMNS`, (n,) each, or None where nothing tells how the trial was played.

    Raises `InputError` for a file that does not cover the trial, or is not in pascal.
    """
    path = played_file(experiment, trial)
    if not path.exists() or trial.drive_is == "measured":
        return None
    columns = read_csv(path, COLUMNS)
    t = columns["t_s"]
    if t[0] > 1e-9 or t[-1] < trial.duration * (1.0 - 1e-6):
        raise InputError(
            f"{path}: covers {t[0]:g} to {t[-1]:g} s; the trial {trial.file} needs 0 to "
            f"{trial.duration:g} s; delete it to take the drive as it was meant"
        )
    for name in COLUMNS[1:]:
        largest = float(np.abs(columns[name]).max())
        if largest > 2e6 or 0.0 < largest < 1e3:
            raise InputError.value(
                f"{path}, column {name}",
                f"at most {largest:g}",
                "0, or peaks of 1e3 to 2e6 Pa",
                "pressures are in pascal, not kPa or psi",
            )
    return columns


def as_played(model: Model, experiment: Experiment, trial: Trial) -> Model:
    """The trial's model with the drive that was played, where that is known; else as it is."""
    rows = changes(experiment, trial)
    if rows is None:
        return model
    front, rear = (_held(rows["t_s"], rows[name]) for name in COLUMNS[1:])
    zero = jnp.zeros(())
    return replace(model, drive=Drive(front, rear, zero, zero))


def switches(experiment: Experiment, trial: Trial) -> np.ndarray | None:
    """Times [s] at which a square wave as it was played jumps; None where that is not known."""
    rows = changes(experiment, trial) if trial.waveform == "square" else None
    if rows is None:
        return None
    jumps = [np.flatnonzero(np.diff(rows[name])) + 1 for name in COLUMNS[1:]]
    return rows["t_s"][np.union1d(*jumps)]


def _held(t: np.ndarray, values: np.ndarray) -> Held:
    """One chamber's changes alone: a wave has at most one break within a step."""
    kept = np.concatenate([[True], np.diff(values) != 0.0])
    t, values = t[kept], values[kept]
    rows = max(LEAST_ROWS, 1 << int(np.ceil(np.log2(len(t) + 1))))
    spare = rows - len(t)
    later = t[-1] + 1.0 + np.arange(spare)
    return Held(
        jnp.asarray(np.concatenate([t, later])),
        jnp.asarray(np.concatenate([values, np.full(spare, values[-1])])),
    )
