"""Stores measured trials as arrays, and faults of these trials as findings."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from slider_jax.channels import Channel, ChannelSet
from slider_jax.errors import InputError
from slider_jax.experiment.drive import pressure_limits
from slider_jax.experiment.load import Experiment, read_measured
from slider_jax.experiment.schema import Trial
from slider_jax.experiment.sensor_tables import SensorsTable

Action = Literal["masked", "mended", "left out", "used", "refused"]


@dataclass(frozen=True)
class Record:
    """One measured trial."""

    trial: Trial
    t: np.ndarray
    """Sample times (n,) [s]."""
    values: np.ndarray
    """Readings (channels, n) in SI units, in the order of `channels`. A missing reading is NaN."""
    channels: ChannelSet
    limits: tuple[tuple[float, float], ...] | None = None
    """Lowest and highest set pressure [Pa] of each chamber. None: no limits."""

    def row(self, channel: str) -> int:
        """Returns the row of `channel` in arrays of readings."""
        return self.channels.row(channel)

    @property
    def pressures(self) -> np.ndarray:
        """Readings (chambers, n) of the pressures [Pa]."""
        return self.values[self.channels.rows(self.channels.pressures)]

    def there(self, channel: str) -> np.ndarray:
        """Returns a mask (n,) of the samples at which `channel` has a reading."""
        return np.isfinite(self.values[self.row(channel)])

    def has(self, channel: str) -> bool:
        """Returns whether `channel` has at least 20 readings, the minimum for a comparison."""
        return int(self.there(channel).sum()) >= 20


def declared_noise(sensors: SensorsTable, channel: Channel) -> float:
    """Returns the declared standard deviation of a channel's white noise; 0 if none is declared."""
    return getattr(sensors, channel.noise) if channel.noise else channel.white


def load_records(experiment: Experiment) -> list[Record]:
    """Returns all trials with a file. Raises `InputError` if no file exists or one is damaged."""
    found, channels = [], experiment.channels
    for trial in experiment.trials:
        columns = read_measured(experiment, trial)
        if columns is None:
            continue
        n = len(columns["t_s"])
        missing = np.full(n, np.nan)
        values = np.stack([columns.get(c.column, missing) for c in channels.values()])
        found.append(Record(trial, columns["t_s"], values, channels, pressure_limits(experiment)))
    if not found:
        raise InputError(
            f"{experiment.folder}: no file of the {len(experiment.trials)} trials "
            f"({experiment.trials[0].file}, ...) exists; copy the trial files to this folder"
        )
    return found


class Finding(NamedTuple):
    """One fault of one file from `from_s` to `to_s` [s], and the audit's action on the faulty data.

    | action | meaning |
    |---|---|
    | `masked` | the audit treats the samples as missing |
    | `mended` | the audit corrects the fault; the field `detail` states the correction |
    | `left out` | the calibration does not use the trial |
    | `used` | the calibration uses the data without a change |
    | `refused` | the calibration cannot use the experiment |
    """

    trial: str
    """Name of the trial's file."""
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
    """Returns the first and the last index of every run of True in `bad` (n,)."""
    edges = np.flatnonzero(np.diff(np.r_[0, bad.astype(int), 0]))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def masked_finding(
    trial: str, kind: str, channel: str, t: np.ndarray, bad: np.ndarray, text: str
) -> Finding:
    """Returns a `masked` finding for the samples `bad` (n,) of a channel at the times `t` (n,)."""
    runs, (begin, end) = true_runs(bad), (float(x) for x in t[bad][[0, -1]])
    many = f" in {len(runs)} intervals" if len(runs) > 1 else ""
    where = f"from {begin:.4g} to {end:.4g} s"
    detail = f"{text}: {bad.sum()} samples{many} {where} are not used"
    return Finding(trial, kind, channel, begin, end, detail, "masked")
