"""Defines the set pressures of the robot's segments and chambers as functions of time.

Each segment of the robot has a left and a right chamber. As in the simulator and the experiment
files, a segment's signed pressure is the left chamber's pressure minus the right chamber's
pressure. Only one chamber of a segment is pressurised at a time.
"""

from dataclasses import dataclass
from math import floor, pi, sin
from typing import Literal

import numpy as np

from rig.errors import RigError
from rig.manifold.limits import PressureLimits, checked_pressures

Waveform = Literal["square", "sine", "trapezoid", "recorded"]


@dataclass(frozen=True)
class SegmentDrive:
    """Signed set pressures of the front and rear segment. The simulator uses the same waveforms.

    The front segment has the `amplitude` [Pa] and the `frequency` [Hz]. The rear segment has
    `rear_ratio` times the amplitude and a delay of `phase` periods. `rise` is the duration of a
    trapezoid's ramp in periods. The waveform "recorded" uses only `times` [s] (n,) and the set
    pressures `recorded` [Pa] (n, 2).
    """

    waveform: Waveform
    frequency: float = 0.0
    amplitude: float = 0.0
    rear_ratio: float = 1.0
    phase: float = 0.0
    rise: float = 0.1
    times: np.ndarray | None = None
    recorded: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.waveform == "recorded":
            if self.times is None or self.recorded is None:
                raise RigError("drive: times or pressures are missing; a recorded drive needs both")
            if not (np.isfinite(self.times).all() and np.isfinite(self.recorded).all()):
                raise RigError("drive: a time or pressure is not finite; give finite numbers")
            return
        numbers = (self.frequency, self.amplitude, self.rear_ratio, self.phase, self.rise)
        if not np.isfinite(numbers).all():
            raise RigError.value("drive", numbers, "finite numbers")
        if self.amplitude and not 0.01 <= self.frequency <= 50.0:
            raise RigError.value("drive's frequency", f"{self.frequency:g}", "0.01 to 50 Hz")

    def segments(self, t: float) -> tuple[float, float]:
        """Returns the set pressures (front, rear) [Pa] at time `t` [s]; 0 for t < 0."""
        if t < 0.0:
            return 0.0, 0.0
        if self.waveform == "recorded":
            assert self.times is not None and self.recorded is not None
            front, rear = (float(np.interp(t, self.times, p)) for p in self.recorded.T)
            return front, rear
        turns = self.frequency * t
        return (
            self.amplitude * self._shape(turns),
            self.amplitude * self.rear_ratio * self._shape(turns - self.phase),
        )

    def _shape(self, turns: float) -> float:
        """Returns the waveform's value, -1 to 1, after `turns` periods."""
        if self.waveform == "sine":
            return sin(2.0 * pi * turns)
        if self.waveform == "square":
            return 1.0 if floor(2.0 * turns + 1e-9) % 2 == 0 else -1.0
        half_turns = round(2.0 * turns)
        sign = 1.0 if half_turns % 2 == 0 else -1.0
        return sign * min(max((turns - half_turns / 2.0) / (0.5 * self.rise), -1.0), 1.0)

    def edges(self, duration: float) -> np.ndarray:
        """Returns the times [s] from 0 to `duration` (excluded) at which a set pressure steps."""
        if self.waveform != "square" or not self.amplitude:
            return np.empty(0)
        # The pressure of a segment with phase p steps at n/2 + p periods, for n = 0, 1, ...
        shifts = np.array([0.0, self.phase % 0.5])
        halves = np.arange(int(2.0 * self.frequency * duration) + 1) / 2.0
        times = np.unique((halves[:, None] + shifts).ravel() / self.frequency)
        return times[times < duration]

    def check(self, limits: PressureLimits, duration: float) -> None:
        """Raises `RigError` if a set pressure exceeds the chamber's limit."""
        if self.waveform == "recorded":
            assert self.recorded is not None
            extremes = [self.recorded.max(axis=0), self.recorded.min(axis=0)]
        else:
            front = abs(self.amplitude)
            highest = np.array([front, front * abs(self.rear_ratio)])
            extremes = [highest, -highest]
        if not duration > 0.0:
            raise RigError.value("duration", f"{duration:g}", "more than 0 s")
        for front, rear in extremes:
            checked_pressures(chamber_pressures(float(front), float(rear)), limits)


def chamber_pressures(front: float, rear: float) -> tuple[float, float, float, float]:
    """Returns the four chambers' gauge pressures [Pa] from the segments' signed pressures [Pa]."""
    return max(front, 0.0), max(-front, 0.0), max(rear, 0.0), max(-rear, 0.0)
