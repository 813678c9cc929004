"""Measured trials as arrays, and findings of an audit about them."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from slider_jax.channels import CHANNELS, row_of
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, read_measured
from slider_jax.experiment.schema import Trial

Action = Literal["masked", "mended", "left out", "used", "refused"]


@dataclass(frozen=True)
class Record:
    """One measured trial."""

    trial: Trial
    t: np.ndarray
    """(n,) [s]."""
    values: np.ndarray
    """(channels, n) in the order of `CHANNELS`, NaN where a sample is missing."""

    def there(self, channel: str) -> np.ndarray:
        """Returns which of the n samples the channel has."""
        return np.isfinite(self.values[row_of(channel)])

    def has(self, channel: str) -> bool:
        """Returns whether the channel has enough samples for a comparison, 20 or more."""
        return int(self.there(channel).sum()) >= 20


def load_records(experiment: Experiment) -> list[Record]:
    """Returns the trials whose files exist. Raises `InputError` for none, or for a damaged file."""
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
            f"{experiment.folder}: no file of the experiment's {len(experiment.trials)} trials "
            f"({experiment.trials[0].file}, ...) exists; put the measured data beside the "
            "experiment file"
        )
    return found


class Finding(NamedTuple):
    """One fault of one file.

    | action | what was done |
    |---|---|
    | `masked` | the samples are treated as missing |
    | `mended` | the fault is corrected, see `detail` |
    | `left out` | the whole trial is not used |
    | `used` | none; the finding is for information |
    | `refused` | the whole experiment is not usable |
    """

    trial: str
    """The file."""
    kind: str
    channel: str | None
    from_s: float | None
    to_s: float | None
    detail: str
    """One sentence for the report."""
    action: Action

    def __str__(self) -> str:
        return f"{self.trial}: {self.detail} ({self.action})"


def true_runs(bad: np.ndarray) -> list[tuple[int, int]]:
    """Returns first and last index of every run of True in `bad` (n,)."""
    edges = np.flatnonzero(np.diff(np.r_[0, bad.astype(int), 0]))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def masked_finding(
    trial: str, kind: str, channel: str, t: np.ndarray, bad: np.ndarray, text: str
) -> Finding:
    """Returns the finding that masks the samples `bad` (n,) of a channel at `t` (n,) [s]."""
    runs, (begin, end) = true_runs(bad), (float(x) for x in t[bad][[0, -1]])
    many = f" in {len(runs)} intervals" if len(runs) > 1 else ""
    where = f"from {begin:.4g} to {end:.4g} s"
    detail = f"{text}: {bad.sum()} samples{many} {where} are not used"
    return Finding(trial, kind, channel, begin, end, detail, "masked")
