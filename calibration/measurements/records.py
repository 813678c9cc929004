"""Measured trials as arrays: every channel of every trial, NaN where a sample is missing."""

from dataclasses import dataclass

import numpy as np

from slider_jax.channels import CHANNELS, row_of
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, read_measured
from slider_jax.experiment.schema import Trial


@dataclass(frozen=True)
class Record:
    """One measured trial."""

    trial: Trial
    t: np.ndarray
    """(n,) [s]."""
    values: np.ndarray
    """(channels, n) in the order of `CHANNELS`, NaN where a sample is missing."""

    def there(self, channel: str) -> np.ndarray:
        """(n,) whether the channel has a sample."""
        return np.isfinite(self.values[row_of(channel)])

    def has(self, channel: str) -> bool:
        """Whether the channel has enough samples to be compared, 20 or more."""
        return int(self.there(channel).sum()) >= 20


def records(experiment: Experiment) -> list[Record]:
    """The trials whose files exist. Raises `InputError` for none, or for a damaged file."""
    found = []
    for trial in experiment.trials:
        columns = read_measured(experiment, trial)
        if columns is None:
            continue
        n = len(columns["t_s"])
        missing = np.full(n, np.nan)
        values = np.stack([columns.get(c.column, missing) for c in CHANNELS.values()])
        found.append(Record(trial, columns["t_s"], values))
    if not found:
        raise InputError(
            f"{experiment.folder}: holds none of the experiment's {len(experiment.trials)} trials "
            f"({experiment.trials[0].file}, ...); calibration needs measured data beside the file"
        )
    return found
