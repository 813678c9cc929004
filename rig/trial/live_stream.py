"""Adds set pressures, forces and the tip position to the manifold's readings during a trial."""

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from threading import Lock
from typing import NamedTuple, TypeVar

import numpy as np

from rig.chambers import ChamberLayout
from rig.manifold.driver import Manifold
from rig.protocol.messages import Follows, ManifoldState, Reading
from rig.recording.clock import RunningClock
from rig.recording.table import BODY_COLUMNS, AnalogueSensor, resample_at_rows

MAX_FORCE_DELAY = 0.05
"""Longest time for which `LiveStream` delays a reading to wait for a later force sample [s]."""
MAX_KEPT = 4096
"""Largest number each of readings, commands and force samples in memory: 4 s of forces at 1 kHz."""
FORCE_MEMORY = 0.2
"""Force samples are deleted if they precede the latest complete reading by this time [s]."""
Item = TypeVar("Item")
Signed = tuple[float, ...]
"""Signed pressures of the actuators [Pa]."""


class LiveReadings(NamedTuple):
    """The n readings that became complete since the last call of `LiveStream.take`."""

    device_s: np.ndarray
    """(n,) times on the manifold's clock [s]."""
    set_pressure: np.ndarray
    """(actuators, n) signed set pressures, means since the previous reading [Pa]."""
    measured: np.ndarray
    """(columns, n) values of the stream's `columns`; NaN for a column without a sensor."""
    arrived_ns: np.ndarray
    """(n,) host times of arrival [ns]."""


class LiveStream:
    """Combines the data of several threads. The threads only append to deques.

    Pass the methods `reading` and `follows` to `Manifold` as callbacks. Pass the `LiveStream`
    itself to `play_drive` in place of the manifold. Readings are used only while the valves follow
    set pressures. `set`, `reading`, `follows` and `force` are thread-safe, other members are not.
    """

    def __init__(
        self,
        layout: ChamberLayout,
        analogue: tuple[AnalogueSensor, ...] = (),
        has_force: bool = False,
    ):
        self.columns = (*layout.columns, *BODY_COLUMNS)
        """Names of the rows of `LiveReadings.measured`."""
        self._layout, self._analogue, self._has_force = layout, analogue, has_force
        self._lock = Lock()
        self._commands: dict[int, tuple[float, ...]] = {}
        self._received: deque[tuple[int, Reading] | Follows] = deque(maxlen=MAX_KEPT)
        self._forces_received: deque[tuple[int, float, float, float]] = deque(maxlen=MAX_KEPT)
        self._clock, self._force_clock = RunningClock(), RunningClock()
        self._rows: deque[tuple[int, Reading, Signed]] = deque(maxlen=MAX_KEPT)
        self._forces: list[tuple[float, float, float]] = []
        self._followed = _Followed(len(layout.actuators))
        self.manifold: Manifold | None = None

    def set(self, pressures: tuple[float, ...]) -> int:
        """Sends set pressures [Pa] to the manifold and returns the command's number."""
        assert self.manifold is not None
        with self._lock:
            seq = self.manifold.set(pressures)
            self._commands[seq] = pressures
            if len(self._commands) > MAX_KEPT:
                self._commands.pop(next(iter(self._commands)))
        return seq

    def reading(self, host_ns: int, reading: Reading) -> None:
        """Adds a reading that arrived at host time `host_ns` [ns]."""
        self._received.append((host_ns, reading))

    def follows(self, change: Follows) -> None:
        """Adds a change of the set pressures that the valves follow."""
        self._received.append(change)

    def force(self, host_ns: int, sensor_s: float, thrust: float, recoil: float) -> None:
        """Adds a force sample [N]. `sensor_s` [s] is the sampling time by the sensor's clock."""
        self._forces_received.append((host_ns, sensor_s, thrust, recoil))

    def take(self) -> LiveReadings:
        """Returns the complete readings. With a force sensor, a reading is complete after a later
        force sample or after `MAX_FORCE_DELAY`. Without a force sensor, all readings are complete.
        """
        self._order()
        forces = np.array(self._forces).reshape(-1, 3).T
        if len(forces[0]):
            forces[0] = self._force_clock.to_host(forces[0])
        rows, at = [], []
        while self._rows:
            host_ns, reading, _ = self._rows[0]
            t = float(self._clock.to_host(1e-6 * reading.device_us))
            waits = self._has_force and not (len(forces[0]) and t <= forces[0, -1])
            if waits and self._rows[-1][0] - host_ns < MAX_FORCE_DELAY * 1e9:
                break
            rows.append(self._rows.popleft())
            at.append(t)
        device = np.array([1e-6 * reading.device_us for _, reading, _ in rows])
        count = len(self._layout.actuators)
        set_pressure = np.array([mean for _, _, mean in rows]).reshape(-1, count).T
        measured = np.full((len(self.columns), len(rows)), np.nan)
        if rows:
            channels = np.array([reading.channels for _, reading, _ in rows], float)
            measured[:count] = self._layout.signed(channels.T)
            for sensor in self._analogue:
                measured[self.columns.index(sensor.column)] = sensor.signal(channels)
        if rows and self._has_force:
            for i in (1, 2):
                measured[count - 1 + i] = resample_at_rows(np.array(at), forces[0], forces[i])
            del self._forces[: int(np.searchsorted(forces[0], at[-1] - FORCE_MEMORY))]
        arrived = np.array([host_ns for host_ns, _, _ in rows], np.int64)
        return LiveReadings(device, set_pressure, measured, arrived)

    def _order(self) -> None:
        """Adds to each new reading the mean set pressures since the previous reading."""
        for host_ns, sensor_s, *forces in _all_of(self._forces_received):
            self._force_clock.add(sensor_s, 1e-9 * host_ns)
            self._forces.append((sensor_s, forces[0], forces[1]))
        del self._forces[:-MAX_KEPT]
        items = list(_all_of(self._received))
        with self._lock:  # held briefly, because `set` waits for the lock
            commands = dict(self._commands)
        for item in items:
            if isinstance(item, Follows):
                self._followed.change(1e-6 * item.device_us, self._layout.signed(item.pressures))
                continue
            host_ns, reading = item
            t, resets = 1e-6 * reading.device_us, self._clock.resets
            self._clock.add(t, 1e-9 * host_ns)
            if self._clock.resets > resets:  # the manifold restarted; earlier times are invalid
                self._rows.clear()
                self._followed.forget()
            if reading.state not in (ManifoldState.ARMED, ManifoldState.PLAYING):
                continue
            pressures = commands.get(reading.command)
            if pressures is not None:
                whole = [int(p) for p in pressures]
                self._followed.at_reading(t, self._layout.signed(whole))
            self._rows.append((host_ns, reading, self._followed.mean_until(t)))


def _all_of(items: deque[Item]) -> Iterator[Item]:
    """Yields and removes the present items. Meanwhile, another thread may append items."""
    for _ in range(len(items)):
        yield items.popleft()


class _Followed:
    """The signed set pressures that the manifold followed, as a function of device time [s]."""

    def __init__(self, actuators: int) -> None:
        self._rest: Signed = (0.0,) * actuators
        self.forget()

    def forget(self) -> None:
        """Deletes all set pressures."""
        self._at: list[float] = [-np.inf]
        self._sets: list[Signed] = [self._rest]
        self._since: float | None = None

    def change(self, t: float, pressures: Signed) -> None:
        """Adds a change of the set pressures at device time `t` [s]."""
        if t < self._at[-1]:  # the manifold restarted
            self.forget()
        self._at.append(t)
        self._sets.append(pressures)

    def at_reading(self, t: float, pressures: Signed) -> None:
        """Adds the set pressures [Pa] that a reading at device time `t` [s] reports.

        If these pressures are new, the `Follows` message of the change was lost. The change is then
        assumed halfway between this reading and the previous reading.
        """
        if self._sets[-1] != pressures:
            self.change(t if self._since is None else 0.5 * (self._since + t), pressures)

    def mean_until(self, t: float) -> Signed:
        """Returns the mean since the previous call's `t`; the first call returns that at `t`."""
        last = bisect_right(self._at, t) - 1
        since, self._since = self._since, t
        if since is None or not since < t:
            mean = self._sets[last]
        else:
            ends = np.array([since, *(x for x in self._at if since < x <= t), t])
            held = np.array(self._sets[last + 2 - len(ends) : last + 1])
            mean = tuple((np.diff(ends) @ held / (t - since)).tolist())
        # The next call needs the value at `t` and later changes.
        del self._at[:last], self._sets[:last]
        return mean
