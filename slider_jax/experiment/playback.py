"""Reads the played drive of a trial: the set pressures that the valves followed, and their times.

Other programs on the computer, the serial line and the manifold's control loop delay each step of
the set pressure by a different time. If a step of 400 kPa is 1 ms late, the pressure differs by
several kilopascals, many times the sensor noise. The actual times remove this error.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from slider_jax.actuation import Held
from slider_jax.dynamics.model import Drive
from slider_jax.errors import InputError
from slider_jax.experiment.drive import check_pascal, pressure_limits, ratios_of
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.schema import Trial
from slider_jax.io.csv import read_csv


def played_columns(chambers: Sequence[str]) -> tuple[str, ...]:
    """Returns the columns of a .played.csv file: the time and the set pressure of each chamber.

    The set pressures of a row apply from the row's time until the time of the next row. The time of
    the last row is the end of the drive.
    """
    return "t_s", *(f"set_{name}_Pa" for name in chambers)


LEAST_ROWS = 64
"""Smallest number of samples in a `Held` wave. Each wave is padded to a power of two, so that
trials with different numbers of samples share compiled programs."""
LONGEST_STEP = 2.5e-3
"""Longest time step [s] of a simulation with a played drive."""
AVERAGING_TIME = 5e-3
"""Length [s] of the intervals in which frequent changes of a set pressure are averaged. The length
is much smaller than the time constant of the pressure."""


class PlayedDrive(NamedTuple):
    """The drive that the valves followed in a trial."""

    drive: Drive
    edges: np.ndarray | None
    """Times [s] at which a square wave changes the set pressures; None for other waveforms."""


def _largest(experiment: Experiment, trial: Trial) -> float:
    """Returns the largest declared |p_set| [Pa] of the first chamber in a periodic drive."""
    size = (trial.amplitude or 0.0) * ratios_of(trial, len(experiment.chambers))[0]
    bias = trial.biases[0] if trial.biases else 0.0
    return float(np.abs(np.clip([bias + size, bias - size], *pressure_limits(experiment)[0])).max())


def read_played(experiment: Experiment, trial: Trial) -> PlayedDrive | None:
    """Returns the drive in NAME.played.csv, the file beside the trial's measured file NAME.csv.

    Returns None if NAME.played.csv does not exist, or if the trial's drive is a measured pressure.
    Raises `InputError` if the drive does not cover the trial, is not in pascal, or has an amplitude
    that differs from the trial's amplitude.
    """
    path = experiment.folder / f"{Path(trial.file).stem}.played.csv"
    if not path.exists() or trial.drive_is == "measured" or not experiment.chambers:
        return None
    names = played_columns(experiment.chamber_names)
    columns = read_csv(path, names)
    t, sets = columns["t_s"], [columns[name] for name in names[1:]]
    advice = "delete the .played.csv file to use the drive of the experiment file"
    if t[0] > 1e-9 or t[-1] < trial.duration * (1.0 - 1e-6):
        raise InputError(
            f"{path}: t_s covers {t[0]:g} to {t[-1]:g} s, but the trial {trial.file} lasts from "
            f"0 to {trial.duration:g} s; {advice}"
        )
    check_pascal(path, columns, names[1:])
    first, given = float(np.abs(sets[0]).max()), _largest(experiment, trial)
    if trial.waveform == "square" and abs(first - given) > 1e-3 * given + 1.0:
        raise InputError(
            f"{path}: the first chamber's amplitude is {first:g} Pa, but {given:g} Pa in the trial "
            f"{trial.file}; correct the trial's amplitude, or {advice}"
        )
    if trial.waveform == "square":
        waves = [_held(t, x) for x in sets]
        edges = t[np.unique(np.concatenate([np.flatnonzero(np.diff(x)) + 1 for x in sets]))]
    else:
        waves, edges = [_held(*_averaged(t, x)) for x in sets], None
    return PlayedDrive(Drive(tuple(waves), jnp.zeros(len(waves))), edges)


def _averaged(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns times and set pressures, averaged over `AVERAGING_TIME` if changes are frequent."""
    if np.diff(t[:-1]).min(initial=np.inf) >= 0.9 * AVERAGING_TIME:
        return t, values
    area = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(t))])
    cells = np.append(np.arange(0.0, t[-1] - 0.5 * AVERAGING_TIME, AVERAGING_TIME), t[-1])
    means = np.diff(np.interp(cells, t, area)) / np.diff(cells)
    return cells, np.append(means, means[-1])


def _held(t: np.ndarray, values: np.ndarray) -> Held:
    """Returns a wave without samples that repeat the previous value.

    `Held` considers only one sample in each time step, so a repeated value could hide a switch in
    the same step. Only the padding at the end repeats a value.
    """
    kept = np.concatenate([[True], np.diff(values) != 0.0])
    t, values = t[kept], values[kept]
    rows = max(LEAST_ROWS, 1 << int(np.ceil(np.log2(len(t) + 1))))
    spare = rows - len(t)
    later = t[-1] + 1.0 + np.arange(spare)
    values = np.concatenate([values, np.full(spare, values[-1])])
    return Held(jnp.asarray(np.concatenate([t, later])), jnp.asarray(values))
