"""How the pressures of all trials answer the drives that are declared."""

from collections.abc import Sequence

import numpy as np

from calibration.audit.lag_response import DeclaredDrive, Fits, drives, fits, settling_time, tone
from calibration.measurements.findings import Action, Finding
from calibration.measurements.records import Record
from slider_jax.channels import BUILT_IN, CHANNELS

NAMES = tuple(CHANNELS[name].column for name in BUILT_IN)
ANSWERS = 0.6
"""Share of its rms that a pressure leaves of the drive's response, above which it is no answer."""
STRIDES = 1.2
"""Settled strides from which on a tone can be told."""


class Answers:
    """Fits of all trials, and the lag and delay that serve most of them."""

    def __init__(
        self, records: Sequence[Record], chambers: Sequence[tuple[DeclaredDrive, DeclaredDrive]]
    ):
        self.all = [_fitted(r, c) for r, c in zip(records, chambers, strict=True)]
        best = np.stack([f.left.min(axis=0) for f in self.all])
        middle = np.median(best.reshape(-1, *best.shape[2:]), axis=0)
        lag, delay = np.unravel_index(int(middle.argmin()), middle.shape)
        self.at = int(lag), int(delay)
        """Index of that lag and delay."""

    def gain(self, i: int) -> np.ndarray:
        """(2 or 5, 2) of trial i: columns against drives, at that lag and delay."""
        return self.all[i].gain[:, :, self.at[0], self.at[1]]

    def left(self, i: int) -> np.ndarray:
        """(2 or 5, 2) likewise."""
        return self.all[i].left[:, :, self.at[0], self.at[1]]

    def own(self, i: int) -> np.ndarray:
        """(2,) what the pressures leave at the lag and delay that suit them best."""
        left = self.all[i].left
        return np.array([left[c, c].min() for c in (0, 1)])


def _fitted(r: Record, chambers: tuple[DeclaredDrive, DeclaredDrive]) -> Fits:
    """Fits of the pressures; of all columns where the pressures' own are no answer."""
    found = fits(r.t, r.values[:2], chambers)
    plain = (found.left.min(axis=(0, 2, 3)) < ANSWERS).all() and not any(tiny(r, c) for c in (0, 1))
    return found if plain else fits(r.t, r.values, chambers)


def tiny(r: Record, row: int) -> bool:
    """Whether a column that should be a pressure in Pa holds numbers of another size."""
    there = r.values[row][np.isfinite(r.values[row])]
    return bool(there.size and np.abs(there).max() < 1e-3 * (r.trial.amplitude or 0.0))


def chambers_of(records: Sequence[Record]) -> list[tuple[DeclaredDrive, DeclaredDrive]]:
    found = [drives(r.trial) for r in records]
    return [x for x in found if x is not None]


def pair(r: Record) -> tuple[float, float] | None:
    """The rear column's lag behind the front's (fraction of a period), and front over rear.

    None of a trial without `STRIDES` settled strides: of less a parabola passes for a tone.
    """
    if not r.trial.frequency or (r.t[-1] - settling_time(r.t)) * r.trial.frequency < STRIDES:
        return None
    tones = []
    for row in (0, 1):
        there = np.isfinite(r.values[row])
        if there.mean() < 0.5:
            return None
        tones.append(tone(r.t[there], r.values[row, there], r.trial.frequency))
    front, rear = tones
    if not front.amplitude or not rear.amplitude:
        return None
    return rear.lag - front.lag, front.amplitude / rear.amplitude


def wrapped(turn: float) -> float:
    return (turn + 0.5) % 1.0 - 0.5


def finding(r: Record, kind: str, channel: str, how: str, action: Action) -> Finding:
    return Finding(r.trial.file, kind, channel, float(r.t[0]), float(r.t[-1]), how, action)
