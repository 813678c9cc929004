"""Reads the played drive of a trial: the set pressures that the valves followed, and their times.

Other programs of the computer, the serial line and the manifold's control loop delay each pressure
step by a different time. In a step of 400 kPa, a delay of 1 ms changes the pressure by several
kilopascals, many times the sensors' noise. The played drive removes this error.
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

PLAYED_COLUMNS = ("t_s", "set_front_Pa", "set_rear_Pa")
"""Columns of the file: signed set pressures from the time `t_s` on. The last row is the end."""
LEAST_ROWS = 64
"""Smallest number of rows. Padding to a power of two lets trials share compiled programs."""
LONGEST_STEP = 2.5e-3
"""Longest step of a simulation with a played drive [s]."""
AVERAGING_TIME = 5e-3
"""Interval [s] in which changes of a smooth wave are averaged. It is much shorter than the lag."""


class PlayedDrive(NamedTuple):
    """The drive that the valves followed in a trial."""

    drive: Drive
    edges: np.ndarray | None
    """Times of a square wave's steps [s]; None for another waveform."""


def read_played(experiment: Experiment, trial: Trial) -> PlayedDrive | None:
    """Returns the drive in NAME.played.csv beside a trial's file, or None without that file.

    Raises `InputError` if the drive does not cover the trial, is not in pascal, or has an amplitude
    that differs from the trial's amplitude.
    """
    path = experiment.folder / f"{Path(trial.file).stem}.played.csv"
    if not path.exists() or trial.drive_is == "measured":
        return None
    columns = read_csv(path, PLAYED_COLUMNS)
    t, sets = columns["t_s"], [columns[name] for name in PLAYED_COLUMNS[1:]]
    advice = "delete it to use the declared drive"
    if t[0] > 1e-9 or t[-1] < trial.duration * (1.0 - 1e-6):
        raise InputError(
            f"{path}: covers {t[0]:g} to {t[-1]:g} s; the trial {trial.file} needs 0 to "
            f"{trial.duration:g} s; {advice}"
        )
    check_pascal(path, columns, PLAYED_COLUMNS[1:])
    front, given = float(np.abs(sets[0]).max()), trial.amplitude
    if trial.waveform == "square" and given is not None and abs(front - given) > 1e-3 * given + 1.0:
        raise InputError(
            f"{path}: the front chamber's amplitude is {front:g} Pa, but {given:g} Pa in the trial "
            f"{trial.file}; correct the trial's amplitude, or {advice}"
        )
    if trial.waveform == "square":
        waves = [_held(t, x) for x in sets]
        edges = t[np.union1d(*(np.flatnonzero(np.diff(x)) + 1 for x in sets))]
    else:
        waves, edges = [_held(*_averaged(t, x)) for x in sets], None
    return PlayedDrive(Drive(waves[0], waves[1], jnp.zeros(()), jnp.zeros(())), edges)


def _averaged(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns times and set pressures; frequent changes are averaged in each `AVERAGING_TIME`."""
    if np.diff(t[:-1]).min(initial=np.inf) >= 0.9 * AVERAGING_TIME:
        return t, values
    area = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(t))])
    cells = np.append(np.arange(0.0, t[-1] - 0.5 * AVERAGING_TIME, AVERAGING_TIME), t[-1])
    means = np.diff(np.interp(cells, t, area)) / np.diff(cells)
    return cells, np.append(means, means[-1])


def _held(t: np.ndarray, values: np.ndarray) -> Held:
    """Returns one chamber's wave without repeated values. The wave may change once in a step."""
    kept = np.concatenate([[True], np.diff(values) != 0.0])
    t, values = t[kept], values[kept]
    rows = max(LEAST_ROWS, 1 << int(np.ceil(np.log2(len(t) + 1))))
    spare = rows - len(t)
    later = t[-1] + 1.0 + np.arange(spare)
    values = np.concatenate([values, np.full(spare, values[-1])])
    return Held(jnp.asarray(np.concatenate([t, later])), jnp.asarray(values))
