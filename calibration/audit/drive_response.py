"""Compares all trials' pressures with a first-order lag's response to the declared drives."""

from collections.abc import Sequence
from typing import NamedTuple

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
from slider_jax.channels import ChannelSet

MAX_RESIDUAL = 0.6
"""A pressure responds to a drive if its relative fit residual (`LagFits`) is below this value."""
STRIDES = 1.2
"""With fewer settled strides, no fundamental (first harmonic) is computed."""


class DriveResponses:
    """Fits of all trials, and the common lag and delay with the smallest median residual."""

    def __init__(self, records: Sequence[Record]):
        chambers = driven_chambers(records)
        self.chambers = range(len(chambers[0]))
        self.all = [_fitted(r, c) for r, c in zip(records, chambers, strict=True)]
        best = np.stack([f.residual.min(axis=0) for f in self.all])
        median = np.nanmedian(best.reshape(-1, *best.shape[2:]), axis=0)
        lag, delay = np.unravel_index(int(median.argmin()), median.shape)
        self.at = int(lag), int(delay)
        """Indices of the common lag and delay in `TIME_CONSTANTS` and `DELAYS`."""

    def gain(self, i: int) -> np.ndarray:
        """Returns trial i's gains (columns, drives) at the common lag and delay."""
        return self.all[i].gain[:, :, self.at[0], self.at[1]]

    def residual(self, i: int) -> np.ndarray:
        """Returns trial i's residuals (columns, drives) at the common lag and delay."""
        return self.all[i].residual[:, :, self.at[0], self.at[1]]

    def least_residual(self, i: int) -> np.ndarray:
        """Returns the least residual (chambers,) of trial i's pressures at any lag and delay."""
        return np.array([self.all[i].residual[c, c].min() for c in self.chambers])


def rows_of_body(channels: ChannelSet) -> list[int]:
    """Returns the rows of all channels except the pressures."""
    return [i for i, x in enumerate(channels.values()) if x.kind != "pressure"]


def sensor_rows(channels: ChannelSet) -> list[int]:
    """Returns the rows of all channels: first the pressures, then the other channels."""
    return [*channels.rows(channels.pressures), *rows_of_body(channels)]


def _fitted(r: Record, chambers: Sequence[DeclaredDrive]) -> LagFits:
    """Returns fits of the pressures, or of all `sensor_rows` if the pressures do not respond."""
    found = fit_lags(r.t, r.pressures, chambers)
    own = driven_in(chambers)
    respond = (found.residual[:, own].min(axis=(0, 2, 3)) < MAX_RESIDUAL).all()
    plain = respond and not any(is_tiny(r, p) for p in r.pressures[own])
    return found if plain else fit_lags(r.t, r.values[sensor_rows(r.channels)], chambers)


def is_tiny(r: Record, pressure: np.ndarray) -> bool:
    """Returns whether the numbers in a pressure's column (n,) are far too small for Pa."""
    there = pressure[np.isfinite(pressure)]
    return bool(there.size and np.abs(there).max() < 1e-3 * (r.trial.amplitude or 0.0))


def drives_of(r: Record) -> tuple[DeclaredDrive, ...] | None:
    """Returns the `declared_drives` of a record's trial."""
    return declared_drives(r.trial, len(r.channels.pressures), r.limits)


def driven_in(drives: Sequence[DeclaredDrive]) -> list[int]:
    """Returns the indices of the chambers whose set pressure changes."""
    return [c for c, x in enumerate(drives) if x.driven]


def driven_chambers(records: Sequence[Record]) -> list[tuple[DeclaredDrive, ...]]:
    """Returns the declared drives of all trials that have declared drives."""
    return [x for x in map(drives_of, records) if x is not None]


class Tones(NamedTuple):
    """The fundamental of each chamber's pressure; NaN if the chamber's set pressure is constant."""

    lag: np.ndarray
    """Lag (chambers,) as a fraction of a period."""
    size: np.ndarray
    """Natural logarithm (chambers,) of the amplitude [Pa]."""


def chamber_tones(r: Record) -> Tones | None:
    """Returns the fundamental of each driven pressure, or None if one has too few readings.

    Returns None for a trial with fewer than `STRIDES` settled strides, because a slow drift of a
    shorter trial could be mistaken for the fundamental.
    """
    drives, f = drives_of(r), r.trial.frequency
    if drives is None or not f or (r.t[-1] - settling_time(r.t)) * f < STRIDES:
        return None
    tones = []
    for p, drive in zip(r.pressures, drives, strict=True):
        if not drive.driven:
            tones.append((np.nan, np.nan))
            continue
        there = np.isfinite(p)
        if there.mean() < 0.5:
            return None
        tones.append(fundamental_tone(r.t[there], p[there], f))
    amplitude, lag = np.array(tones).T
    return Tones(lag, np.log(amplitude)) if amplitude.all() else None


def wrapped(phase):
    """Returns phases [periods], reduced by whole periods to values between -0.5 and 0.5."""
    return (phase + 0.5) % 1.0 - 0.5


def trial_finding(r: Record, kind: str, channel: str, detail: str, action: Action) -> Finding:
    """Returns a finding on a channel of a whole trial."""
    return Finding(r.trial.file, kind, channel, float(r.t[0]), float(r.t[-1]), detail, action)
