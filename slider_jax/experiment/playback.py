"""The drive as it was played: the set pressures that the valves followed, and when.

The computer beside a tank switches late: its other work, the line and the manifold's own loop delay
each edge differently. At an edge of 400 kPa, a delay of 1 ms changes the pressure by several
kilopascals while the chamber fills, many times the sensors' noise. Where the manifold reports the
commands that it followed, this error is removed.
"""

from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from slider_jax.actuation import Held
from slider_jax.dynamics.model import Drive
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, check_pascal
from slider_jax.experiment.schema import Trial
from slider_jax.io.csv import read_csv

COLUMNS = ("t_s", "set_front_Pa", "set_rear_Pa")
"""Each row's signed set pressures hold from its time on; the last row is the trial's end."""
LEAST_ROWS = 64
"""Changes are padded to a power of two, at least this, so that trials share compiled programs."""
LONGEST_STEP = 2.5e-3
"""Longest step of a simulation with a played drive [s]."""
CELL = 5e-3
"""Changes of a smooth wave are averaged over this time [s], which a chamber's lag hides."""


class PlayedDrive(NamedTuple):
    """The drive that a trial was run with."""

    drive: Drive
    edges: np.ndarray | None
    """Times [s] at which a square wave jumped; None for another waveform."""


def read_played(experiment: Experiment, trial: Trial) -> PlayedDrive | None:
    """The drive in NAME.played.csv beside a trial's file; None without that file.

    Raises `InputError` for one that does not cover the trial, is not in pascal, or is of a drive
    with another amplitude than the trial's.
    """
    path = experiment.folder / f"{Path(trial.file).stem}.played.csv"
    if not path.exists() or trial.drive_is == "measured":
        return None
    columns = read_csv(path, COLUMNS)
    t, sets = columns["t_s"], [columns[name] for name in COLUMNS[1:]]
    otherwise = "delete it to take the drive as it was meant"
    if t[0] > 1e-9 or t[-1] < trial.duration * (1.0 - 1e-6):
        raise InputError(
            f"{path}: covers {t[0]:g} to {t[-1]:g} s; the trial {trial.file} needs 0 to "
            f"{trial.duration:g} s; {otherwise}"
        )
    check_pascal(path, columns, COLUMNS[1:])
    front, meant = float(np.abs(sets[0]).max()), trial.amplitude
    if trial.waveform == "square" and meant is not None and abs(front - meant) > 1e-3 * meant + 1.0:
        raise InputError(
            f"{path}: the front chamber was played at {front:g} Pa; the trial {trial.file} says "
            f"{meant:g} Pa; give the amplitude that was played, or {otherwise}"
        )
    zero = jnp.zeros(())
    if trial.waveform != "square":
        smooth = [_held(*_evened(t, x)) for x in sets]
        return PlayedDrive(Drive(smooth[0], smooth[1], zero, zero), None)
    jumps = [np.flatnonzero(np.diff(x)) + 1 for x in sets]
    drive = Drive(_held(t, sets[0]), _held(t, sets[1]), zero, zero)
    return PlayedDrive(drive, t[np.union1d(*jumps)])


def _evened(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mean over each `CELL`, where changes come closer: those of a smooth wave may do so."""
    if np.diff(t[:-1]).min(initial=np.inf) >= 0.9 * CELL:
        return t, values
    area = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(t))])
    cells = np.append(np.arange(0.0, t[-1] - 0.5 * CELL, CELL), t[-1])
    means = np.diff(np.interp(cells, t, area)) / np.diff(cells)
    return cells, np.append(means, means[-1])


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
