"""Compares all trials' pressures with a first-order lag's response to the declared drives."""

from collections.abc import Sequence

import numpy as np

from calibration.audit.lag_response import (
    DeclaredDrive,
    LagFits,
    declared_drives,
    fit_lags,
    fundamental_tone,
    settling_time,
)
from calibration.measurements.records import Action, Finding, Record
from slider_jax.channels import BUILT_IN, CHANNELS

NAMES = tuple(CHANNELS[name].column for name in BUILT_IN)
MAX_RESIDUAL = 0.6
"""A pressure responds to a drive if its relative fit residual (`LagFits`) is below this value."""
STRIDES = 1.2
"""With fewer settled strides, no fundamental (first harmonic) is computed."""


class DriveResponses:
    """Fits of all trials, and the common lag and delay with the smallest median residual."""

    def __init__(self, records: Sequence[Record]):
        chambers = driven_chambers(records)
        self.all = [_fitted(r, c) for r, c in zip(records, chambers, strict=True)]
        best = np.stack([f.residual.min(axis=0) for f in self.all])
        median = np.median(best.reshape(-1, *best.shape[2:]), axis=0)
        lag, delay = np.unravel_index(int(median.argmin()), median.shape)
        self.at = int(lag), int(delay)
        """Indices of the common lag and delay in `TIME_CONSTANTS` and `DELAYS`."""

    def gain(self, i: int) -> np.ndarray:
        """Returns trial i's gains (2 or 5 columns, 2 drives) at the common lag and delay."""
        return self.all[i].gain[:, :, self.at[0], self.at[1]]

    def residual(self, i: int) -> np.ndarray:
        """Returns trial i's residuals (2 or 5 columns, 2 drives) at the common lag and delay."""
        return self.all[i].residual[:, :, self.at[0], self.at[1]]

    def least_residual(self, i: int) -> np.ndarray:
        """Returns the residuals (2,) of trial i's pressures, each at its best lag and delay."""
        return np.array([self.all[i].residual[c, c].min() for c in (0, 1)])


def _fitted(r: Record, chambers: tuple[DeclaredDrive, DeclaredDrive]) -> LagFits:
    """Returns the fits of the pressures, or of all columns if the pressures do not respond."""
    found = fit_lags(r.t, r.values[:2], chambers)
    respond = (found.residual.min(axis=(0, 2, 3)) < MAX_RESIDUAL).all()
    plain = respond and not any(is_tiny(r, c) for c in (0, 1))
    return found if plain else fit_lags(r.t, r.values[: len(BUILT_IN)], chambers)


def is_tiny(r: Record, row: int) -> bool:
    """Returns whether the numbers in a pressure's column are far too small for Pa."""
    there = r.values[row][np.isfinite(r.values[row])]
    return bool(there.size and np.abs(there).max() < 1e-3 * (r.trial.amplitude or 0.0))


def driven_chambers(records: Sequence[Record]) -> list[tuple[DeclaredDrive, DeclaredDrive]]:
    """Returns the declared drives of all trials that have declared drives."""
    found = [declared_drives(r.trial) for r in records]
    return [x for x in found if x is not None]


def rear_lag_and_ratio(r: Record) -> tuple[float, float] | None:
    """Returns the rear pressure's lag behind the front's, and the ratio of front to rear amplitude.

    The lag is a fraction of a period. Returns None for a trial with fewer than `STRIDES` settled
    strides, because a slow drift of a shorter trial could be mistaken for the fundamental.
    """
    if not r.trial.frequency or (r.t[-1] - settling_time(r.t)) * r.trial.frequency < STRIDES:
        return None
    tones = []
    for row in (0, 1):
        there = np.isfinite(r.values[row])
        if there.mean() < 0.5:
            return None
        tones.append(fundamental_tone(r.t[there], r.values[row, there], r.trial.frequency))
    (front, front_lag), (rear, rear_lag) = tones
    return (rear_lag - front_lag, front / rear) if front and rear else None


def wrapped(phase: float) -> float:
    """Returns a phase [periods], reduced by whole periods to a value between -0.5 and 0.5."""
    return (phase + 0.5) % 1.0 - 0.5


def trial_finding(r: Record, kind: str, channel: str, detail: str, action: Action) -> Finding:
    """Returns a finding on a channel of a whole trial."""
    return Finding(r.trial.file, kind, channel, float(r.t[0]), float(r.t[-1]), detail, action)
