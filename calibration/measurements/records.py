"""Measured trials as arrays: the five channels of every trial, with what is missing."""

from dataclasses import dataclass

import numpy as np

from calibration.model.predict import CHANNELS
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, measured
from slider_jax.experiment.schema import Trial

COLUMNS = dict(
    zip(CHANNELS, ("p_front_Pa", "p_rear_Pa", "thrust_N", "recoil_N", "tip_m"), strict=True)
)
"""Column of a trial's file for each channel."""


@dataclass(frozen=True)
class Record:
    """One measured trial."""

    trial: Trial
    t: np.ndarray
    """(n,) [s]."""
    values: np.ndarray
    """(5, n): `CHANNELS`, NaN where a sample is missing."""

    def there(self, channel: str) -> np.ndarray:
        """(n,) whether the channel has a sample."""
        return np.isfinite(self.values[CHANNELS.index(channel)])

    def has(self, channel: str) -> bool:
        """Whether there is enough of a channel to be compared."""
        return int(self.there(channel).sum()) >= 20


def records(experiment: Experiment) -> list[Record]:
    """The trials whose files are there. Raises `InputError` for none, or for a damaged file."""
    found = []
    for trial in experiment.trials:
        columns = measured(experiment, trial)
        if columns is None:
            continue
        n = len(columns["t_s"])
        values = np.stack([columns.get(name, np.full(n, np.nan)) for name in COLUMNS.values()])
        found.append(Record(trial, columns["t_s"], values))
    if not found:
        raise InputError(
            f"{experiment.folder}: holds none of the experiment's {len(experiment.trials)} trials "
            f"({experiment.trials[0].file}, ...); calibration needs measured data beside the file"
        )
    return found
