"""A drive is played: set pressures at an even rate, and at every edge at its own time."""

import time
from collections.abc import Callable
from math import cos, pi
from typing import NamedTuple, Protocol

import numpy as np

from rig.recording.clock import host_ns
from rig.trial.waveform import SegmentDrive, chamber_pressures

RATE = 200.0
"""Commands a second."""


class Settable(Protocol):
    """What set pressures are sent to."""

    def set(self, pressures: tuple[float, float, float, float], /) -> int: ...


class PlaybackRecord(NamedTuple):
    """How a drive was played."""

    begun_ns: int
    """Host time of its t = 0 [ns]."""
    lateness: np.ndarray
    """(commands,) [s] from when each was due until it was on the wire."""


def command_times(drive: SegmentDrive, duration: float, rate: float = RATE) -> np.ndarray:
    """Times [s] of all commands, from 0 and before `duration`."""
    even = np.arange(int(np.ceil(duration * rate))) / rate
    even = even[even < duration]
    edges = drive.edges(duration)
    times = np.union1d(even, edges)
    # Of an edge and an even time that rounding put beside each other the later one is behind both.
    return times[np.append(np.diff(times) > 1e-6, True)]


def play_drive(
    manifold: Settable,
    drive: SegmentDrive,
    duration: float,
    rate: float = RATE,
    watch: Callable[[float], None] = lambda t: None,
    fade: float = 0.0,
) -> PlaybackRecord:
    """Plays it, now. `watch` hears of every command's time [s]; what it raises ends the trial.

    After `duration` it dies away over `fade` [s], as the square of a cosine: a body that is let go
    of at once swings for a minute, where only drag that grows with the square of speed damps it.
    """
    end = duration + fade
    times = command_times(drive, end, rate)
    lateness = np.empty(len(times))
    start = time.monotonic() + 0.002
    begun = host_ns() + round((start - time.monotonic()) * 1e9)
    for i, t in enumerate(times):
        left = 1.0 if t < duration else cos(0.5 * pi * (t - duration) / fade) ** 2
        front, rear = drive.segments(t)
        pressures = chamber_pressures(left * front, left * rear)
        wait_until(start + t)
        manifold.set(pressures)
        lateness[i] = time.monotonic() - (start + t)
        watch(float(t))
    wait_until(start + end)
    return PlaybackRecord(begun, lateness)


def wait_until(deadline: float) -> None:
    """Until `deadline` of `time.monotonic`."""
    while (left := deadline - time.monotonic()) > 0.0:
        time.sleep(left)
