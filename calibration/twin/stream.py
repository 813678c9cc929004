"""From readings as they come to even blocks: lost readings are bridged and marked."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slider_jax.errors import InputError

LONGEST_GAP = 0.2
"""[s] that are bridged; after a longer gap the blocks begin anew at the next reading."""


class Samples(NamedTuple):
    """Readings in the order of their device times; NaN where a sensor read nothing."""

    t: np.ndarray
    """(n,) [s], of the device's clock."""
    set_pressure: np.ndarray
    """(2, n) [Pa], front and rear, signed: the mean since the reading before. An edge between two
    readings shows in it, and at the reading alone would not."""
    measured: np.ndarray
    """(5, n) in the order of `slider_jax.channels.BUILT_IN`: Pa, Pa, N, N, m."""

    def checked(self) -> "Samples":
        """The same as float arrays. Raises `InputError` for other shapes."""
        found = Samples(*(np.asarray(x, float) for x in self))
        n = found.t.shape[-1] if found.t.ndim else 0
        for name, shape in {"t": (n,), "set_pressure": (2, n), "measured": (5, n)}.items():
            given = getattr(found, name).shape
            if given != shape:
                raise InputError.value(
                    f"readings, {name}", f"shape {given}", f"{shape} for n = {n}"
                )
        return found


class UniformBlock(NamedTuple):
    """Samples of a block, evenly spaced."""

    t: np.ndarray
    """(samples,) [s]"""
    set_pressure: np.ndarray
    """(2, samples), over what was lost the mean of all of it."""
    measured: np.ndarray
    """(5, samples), NaN where lost."""
    lost: np.ndarray
    """(samples,) whether the reading was."""
    anew: bool
    """Whether the block does not follow the one before."""


@dataclass
class GapFiller:
    """Puts readings on an even grid `period` [s] of the device's clock, `samples` a block."""

    period: float
    samples: int
    lost: int = 0
    """Readings that did not come, of gaps that were bridged."""
    repeated: int = 0
    """Readings that came again, late, or without a time; they are dropped."""
    gaps: int = 0
    """Gaps too long to be bridged."""

    def __post_init__(self):
        self._origin: float | None = None
        self._slot = -1
        self._last = np.zeros(2)
        self._rows: list[tuple[float, np.ndarray, np.ndarray, bool]] = []
        self._anew = True

    def add(self, readings: Samples) -> Iterator[UniformBlock]:
        """The blocks that these readings complete. Raises `InputError` for wrong shapes."""
        t, set_pressure, measured = readings.checked()
        for i in np.flatnonzero(np.isfinite(t)):
            self._add(float(t[i]), set_pressure[:, i], measured[:, i])
            while len(self._rows) >= self.samples:
                yield self._block()
        self.repeated += int(np.sum(~np.isfinite(t)))

    def _add(self, t: float, set_pressure: np.ndarray, measured: np.ndarray) -> None:
        if self._origin is None:
            self._origin = t
        slot = round((t - self._origin) / self.period)
        missing = slot - self._slot - 1
        if abs(missing) > LONGEST_GAP / self.period:
            self.gaps += 1
            self._rows, self._anew, self._origin, slot, missing = [], True, t, 0, 0
        if missing < 0:
            self.repeated += 1
            return
        now = np.where(np.isfinite(set_pressure), set_pressure, self._last)
        for j in range(1, missing + 1):
            self._rows.append((self._time(self._slot + j), now, np.full(5, np.nan), True))
        self.lost += missing
        read = np.where(np.isfinite(measured), measured, np.nan)
        self._rows.append((self._time(slot), now, read, False))
        self._slot, self._last = slot, now

    def _time(self, slot: int) -> float:
        assert self._origin is not None
        return self._origin + slot * self.period

    def _block(self) -> UniformBlock:
        rows, self._rows = self._rows[: self.samples], self._rows[self.samples :]
        t, set_pressure, measured, lost = zip(*rows, strict=True)
        anew, self._anew = self._anew, False
        return UniformBlock(
            np.array(t), np.array(set_pressure).T, np.array(measured).T, np.array(lost), anew
        )
