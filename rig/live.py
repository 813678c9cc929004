"""A rig's streams as they come: set and measured values at the manifold's readings."""

from collections import deque
from threading import Lock
from typing import NamedTuple

import numpy as np

from rig.clock import RunningClock
from rig.columns import Analogue
from rig.manifold import Manifold
from rig.messages import Reading

CHANNELS_OUT = ("p_front_Pa", "p_rear_Pa", "thrust_N", "recoil_N", "tip_m")
LATEST = 0.05
"""A force sample that is so late is not waited for [s]."""
KEPT = 4096
Pressures = tuple[float, float, float, float]


class Live(NamedTuple):
    """Readings (n,) that came since the last time."""

    device_s: np.ndarray
    set_pressure: np.ndarray
    """(2, n) signed, front and rear [Pa], as the manifold followed them."""
    measured: np.ndarray
    """(5, n) as `CHANNELS_OUT`; NaN where no sensor gave a value."""
    arrived_ns: np.ndarray
    """Host time of arrival [ns]."""


class LiveStream:
    """Puts together what threads hand in. Give `reading` to the manifold, `set` to the player."""

    def __init__(self, analogue: tuple[Analogue, ...] = (), has_force: bool = False):
        self._analogue, self._has_force = analogue, has_force
        self._lock = Lock()
        self._clock = RunningClock()
        self._commands: dict[int, Pressures] = {}
        self._readings: deque[tuple[int, Reading]] = deque(maxlen=KEPT)
        self._forces: deque[tuple[int, float, float]] = deque(maxlen=KEPT)
        self.manifold: Manifold | None = None

    def set(self, pressures: Pressures) -> int:
        """Sets them on the manifold, and notes which command that was."""
        assert self.manifold is not None
        with self._lock:
            seq = self.manifold.set(pressures)
            self._commands[seq] = pressures
            if len(self._commands) > KEPT:
                self._commands.pop(next(iter(self._commands)))
        return seq

    def reading(self, host_ns: int, reading: Reading) -> None:
        """A reading and when it arrived."""
        self._readings.append((host_ns, reading))

    def force(self, host_ns: int, thrust: float, recoil: float) -> None:
        """A force sample [N] and when it arrived [ns]."""
        self._forces.append((host_ns, thrust, recoil))

    def clear(self) -> None:
        """Forgets what has come so far."""
        self._readings.clear()

    def take(self) -> Live:
        """What is complete: readings up to the latest force sample, if forces are measured."""
        forces = list(self._forces)
        rows = []
        while self._readings:
            host_ns, _ = self._readings[0]
            newest = forces[-1][0] if forces else 0
            waits = self._has_force and newest < host_ns
            if waits and self._readings[-1][0] - host_ns < LATEST * 1e9:
                break
            rows.append(self._readings.popleft())
        n = len(rows)
        set_pressure, measured = np.zeros((2, n)), np.full((5, n), np.nan)
        device, arrived = np.zeros(n), np.zeros(n, np.int64)
        with self._lock:  # not for longer: the player waits for it
            commands = dict(self._commands)
        for i, (host_ns, reading) in enumerate(rows):
            device[i], arrived[i] = 1e-6 * reading.device_us, host_ns
            self._clock.add(device[i], 1e-9 * host_ns)
            a, b, c, d = commands.get(reading.command, (0.0, 0.0, 0.0, 0.0))
            set_pressure[:, i] = a - b, c - d
            p = reading.channels
            measured[:2, i] = p[0] - p[1], p[2] - p[3]
            for sensor in self._analogue:
                measured[CHANNELS_OUT.index(sensor.column), i] = sensor.signal(np.array(p))
        if forces and n:
            t, thrust, recoil = np.array(forces, float).T
            at = np.array([float(self._clock.to_host(x)) for x in device])
            measured[2] = np.interp(at, 1e-9 * t, thrust, left=np.nan, right=np.nan)
            measured[3] = np.interp(at, 1e-9 * t, recoil, left=np.nan, right=np.nan)
        return Live(device, set_pressure, measured, arrived)
