"""Plays a drive: sends set pressures at a constant rate and also at each pressure step."""

import time
from collections.abc import Callable
from math import cos, pi
from typing import NamedTuple, Protocol

import numpy as np

from rig.recording.clock import host_ns
from rig.trial.waveform import ChamberDrive

RATE = 200.0
"""Default number of commands per second. The manifold vents after 0.1 s without a command."""


class Settable(Protocol):
    """A receiver of set pressures."""

    def set(self, pressures: tuple[float, ...], /) -> int: ...


class PlaybackRecord(NamedTuple):
    """Start time of a played drive, and lateness of its commands."""

    begun_ns: int
    """Host time of the drive's t = 0 [ns]."""
    lateness: np.ndarray
    """(commands,) time from the scheduled to the actual sending of each command [s]."""


def command_times(drive: ChamberDrive, duration: float, rate: float = RATE) -> np.ndarray:
    """Returns the times [s] of all commands in [0, duration)."""
    regular = np.arange(int(np.ceil(duration * rate))) / rate
    regular = regular[regular < duration]
    times = np.union1d(regular, drive.edges(duration))
    # If rounding separates a pressure step from a regular time, only the later time is kept.
    return times[np.append(np.diff(times) > 1e-6, True)]


def play_drive(
    manifold: Settable,
    drive: ChamberDrive,
    duration: float,
    rate: float = RATE,
    watch: Callable[[float], None] = lambda t: None,
    fade: float = 0.0,
) -> PlaybackRecord:
    """Plays a drive immediately, and returns its start time and the commands' lateness.

    `watch` is called with each command's time [s]. An exception in `watch` ends the drive. After
    `duration` [s], the amplitude decreases to 0 within `fade` [s], as a squared cosine. An abrupt
    end would let the body swing for a minute, because quadratic drag hardly damps small motions.
    """
    end = duration + fade
    times = command_times(drive, end, rate)
    lateness = np.empty(len(times))
    start = time.monotonic() + 0.002
    begun = host_ns() + round((start - time.monotonic()) * 1e9)
    for i, t in enumerate(times):
        scale = 1.0 if t < duration else cos(0.5 * pi * (t - duration) / fade) ** 2
        pressures = drive.layout.split([scale * p for p in drive.signed(t)])
        wait_until(start + t)
        manifold.set(pressures)
        lateness[i] = time.monotonic() - (start + t)
        watch(float(t))
    wait_until(start + end)
    return PlaybackRecord(begun, lateness)


def wait_until(deadline: float) -> None:
    """Sleeps until `time.monotonic` reaches `deadline` [s]."""
    while (remaining := deadline - time.monotonic()) > 0.0:
        time.sleep(remaining)
