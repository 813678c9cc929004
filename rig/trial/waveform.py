"""Defines the set pressures of the robot's actuators and chambers as functions of time."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import floor, pi, sin
from typing import Literal

import numpy as np

from rig.chambers import SLIDER, ChamberLayout
from rig.errors import RigError
from rig.manifold.limits import PressureLimits

Waveform = Literal["square", "sine", "trapezoid", "recorded"]


@dataclass(frozen=True)
class ChamberDrive:
    """Signed set pressures of the actuators of a `layout`. The simulator uses the same waveforms.

    The wave has the `amplitude` [Pa] and the `frequency` [Hz]. Each actuator has its own of the
    `ratios` to the amplitude (default: 1), its delay in `phases` periods (default: 0) and its
    constant `biases` [Pa] (default: 0). `rise` is the duration of a trapezoid's ramp in periods.
    The waveform "recorded" uses only `times` [s] (n,) and the set pressures `recorded` [Pa]
    (n, actuators). A single chamber has no pressure on the other side.
    """

    waveform: Waveform
    frequency: float = 0.0
    amplitude: float = 0.0
    ratios: tuple[float, ...] = ()
    phases: tuple[float, ...] = ()
    biases: tuple[float, ...] = ()
    rise: float = 0.1
    times: np.ndarray | None = None
    recorded: np.ndarray | None = None
    layout: ChamberLayout = SLIDER

    def __post_init__(self) -> None:
        count = len(self.layout.actuators)
        for name, default in (("ratios", 1.0), ("phases", 0.0), ("biases", 0.0)):
            given = getattr(self, name) or (default,) * count
            if len(given) != count:
                raise RigError.value(f"drive's {name}", given, f"{count} numbers")
            object.__setattr__(self, name, tuple(given))
        if self.waveform == "recorded":
            if self.times is None or self.recorded is None:
                raise RigError("drive: times or pressures are missing; a recorded drive needs both")
            shape, allowed = self.recorded.shape, (len(self.times), count)
            if shape != allowed:
                raise RigError.value("drive's recorded pressures, shape", shape, f"{allowed}")
            if not (np.isfinite(self.times).all() and np.isfinite(self.recorded).all()):
                raise RigError("drive: a time or pressure is not finite; give finite numbers")
            return
        numbers = (
            *(self.frequency, self.amplitude, self.rise),
            *(*self.ratios, *self.phases, *self.biases),
        )
        if not np.isfinite(numbers).all():
            raise RigError.value("drive", numbers, "finite numbers")
        if self.amplitude and not 0.01 <= self.frequency <= 50.0:
            raise RigError.value("drive's frequency", f"{self.frequency:g}", "0.01 to 50 Hz")

    def signed(self, t: float) -> tuple[float, ...]:
        """Returns the signed set pressures (actuators,) [Pa] at time `t` [s]; 0 for t < 0."""
        if t < 0.0:
            return (0.0,) * len(self.layout.actuators)
        if self.waveform == "recorded":
            assert self.times is not None and self.recorded is not None
            return self._possible(float(np.interp(t, self.times, p)) for p in self.recorded.T)
        turns = self.frequency * t
        return self._possible(
            bias + self.amplitude * ratio * self._shape(turns - phase)
            for ratio, phase, bias in zip(self.ratios, self.phases, self.biases, strict=True)
        )

    def _possible(self, pressures: Iterable[float]) -> tuple[float, ...]:
        both = zip(pressures, self.layout.actuators, strict=True)
        return tuple(actuator.possible(p) for p, actuator in both)

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
        # The pressure of an actuator with phase p steps at n/2 + p periods, for n = 0, 1, ...
        shifts = np.array(self.phases) % 0.5
        halves = np.arange(int(2.0 * self.frequency * duration) + 1) / 2.0
        times = np.unique((halves[:, None] + shifts).ravel() / self.frequency)
        return times[times < duration]

    def check(self, limits: PressureLimits, duration: float) -> None:
        """Raises `RigError` if a set pressure exceeds the chamber's limit."""
        if self.waveform == "recorded":
            assert self.recorded is not None
            extremes = [self.recorded.max(axis=0), self.recorded.min(axis=0)]
        else:
            highest = np.abs(self.amplitude * np.array(self.ratios))
            extremes = [self.biases + highest, self.biases - highest]
        if not duration > 0.0:
            raise RigError.value("duration", f"{duration:g}", "more than 0 s")
        for signed in extremes:
            limits.checked(self.layout.split(signed.tolist()))
