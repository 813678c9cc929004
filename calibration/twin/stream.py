"""Converts a stream of readings to blocks of evenly spaced samples, and marks lost readings."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slider_jax.channels import OF_BODY
from slider_jax.errors import InputError

MAX_GAP = 0.2
"""Longest gap [s] that is filled with NaN. After a longer gap, a new block begins."""


class Samples(NamedTuple):
    """Readings in the order of the device's clock. A missing reading is NaN."""

    t: np.ndarray
    """Times (n,) [s] on the device's clock."""
    set_pressure: np.ndarray
    """Set pressures (actuators, n) [Pa], each averaged from the previous reading to this reading,
    because set pressures also change between two readings."""
    measured: np.ndarray
    """Readings (channels, n) of `calibration.twin.block.live_channels`, in Pa, N and m."""

    def checked(self, actuators: int) -> "Samples":
        """Returns the samples as float arrays. Raises `InputError` for a wrong shape."""
        samples = Samples(*(np.asarray(x, float) for x in self))
        n = samples.t.shape[-1] if samples.t.ndim else 0
        rows = {"set_pressure": actuators, "measured": actuators + len(OF_BODY)}
        for name, shape in {"t": (n,), **{name: (x, n) for name, x in rows.items()}}.items():
            given = getattr(samples, name).shape
            if given != shape:
                raise InputError.value(
                    f"readings, {name}", f"shape {given}", f"{shape} for n = {n}"
                )
        return samples


class UniformBlock(NamedTuple):
    """Evenly spaced samples of a block."""

    t: np.ndarray
    """Times (samples,) [s]."""
    set_pressure: np.ndarray
    """Set pressures (actuators, samples) [Pa]. All samples in a gap have the mean of the gap."""
    measured: np.ndarray
    """Readings (channels, samples). A lost reading is NaN."""
    lost: np.ndarray
    """Whether the reading was lost, (samples,)."""
    restarted: bool
    """Whether the block is the first block, or follows a long gap."""


@dataclass
class GapFiller:
    """Assigns readings to times with the spacing `period` [s]. A block has `samples` times."""

    period: float
    samples: int
    actuators: int
    """Number of the robot's pneumatic actuators."""
    lost: int = 0
    """Number of lost readings in gaps of up to `MAX_GAP`."""
    repeated: int = 0
    """Number of dropped readings: repeated, out of order, or without a time."""
    gaps: int = 0
    """Number of gaps longer than `MAX_GAP`."""

    def __post_init__(self) -> None:
        self._origin: float | None = None
        self._slot = -1
        self._last = np.zeros(self.actuators)
        self._rows: list[tuple[float, np.ndarray, np.ndarray, bool]] = []
        self._anew = True

    def add(self, readings: Samples) -> Iterator[UniformBlock]:
        """Yields the blocks that these readings complete. Raises `InputError` for wrong shapes."""
        t, set_pressure, measured = readings.checked(self.actuators)
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
        if abs(missing) > MAX_GAP / self.period:
            self.gaps += 1
            self._rows, self._anew, self._origin, slot, missing = [], True, t, 0, 0
        if missing < 0:
            self.repeated += 1
            return
        now = np.where(np.isfinite(set_pressure), set_pressure, self._last)
        unknown = np.full(len(measured), np.nan)
        for j in range(1, missing + 1):
            self._rows.append((self._time(self._slot + j), now, unknown, True))
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
        restarted, self._anew = self._anew, False
        return UniformBlock(
            np.array(t), np.array(set_pressure).T, np.array(measured).T, np.array(lost), restarted
        )
