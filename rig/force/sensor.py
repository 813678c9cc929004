"""Defines the force sensors: a source streams raw records, and a calibration converts records.

| sensor | source | calibration |
|---|---|---|
| ATI Net F/T box, by UDP | `rig.force.ati_net.NetForce` | `rig.force.ati_net.NetCalibration` |
| six gauges, NI card | `rig.force.ni_daq.GaugeForce` | `rig.force.ni_daq.GaugeCalibration` |

The thread of a source calls the sink with the host's monotonic time of arrival [ns] and the
received bytes. The calibration's method `forces` converts these bytes into forces at known times.
"""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from threading import Event, Thread
from typing import NamedTuple, Protocol

import numpy as np

from rig.errors import RigError
from rig.recording.clock import Sink
from rig.recording.reader import RecordedStream
from rig.recording.table import SampledColumns, StreamReader

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")

NEWTONS = {"n": 1.0, "kn": 1e3, "lbf": 4.4482216152605, "klbf": 4448.2216152605, "kg": 9.80665}
NEWTON_METRES = {
    "nm": 1.0, "nmm": 1e-3, "knm": 1e3, "kgcm": 0.0980665,
    "lbfin": 0.1129848290276167, "lbfft": 1.3558179483314004,
}  # fmt: skip
"""SI value of each unit. The keys are ATI's names of the units in lower case, without hyphens."""


def unit_in_si(unit: str, known: dict[str, float], where: str) -> float:
    """Returns the SI value [N or N m] of one `unit`. Raises `RigError` for an unknown unit."""
    name = unit.strip().lower().replace("-", "").replace(" ", "").replace("lbin", "lbfin")
    if name not in known:
        raise RigError.value(
            where, f"unit {unit!r}", ", ".join(known), "set the sensor's units to N and N-m"
        )
    return known[name]


def check_positive(where: str, **values: float) -> None:
    """Raises `RigError` if a value is not a finite number above 0."""
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise RigError.value(f"{where}, {name}", value, "a number above 0")


class Forces(NamedTuple):
    """Forces of one recording."""

    t_ns: np.ndarray
    """(n,) sampling times on the host's monotonic clock [ns], evenly spaced."""
    wrench: np.ndarray
    """(n, 6) forces [N] and torques [N m] in the order of `AXES`; NaN for a lost sample."""
    doubtful: np.ndarray
    """(n,) True where the sensor was saturated, stuck, or reported an error."""
    findings: tuple[str, ...]
    """Problems for the user, one sentence each."""


@dataclass(frozen=True)
class SensorMounting:
    """The sensor's axes, with sign, that measure thrust and recoil.

    Thrust (towards the head) and recoil (towards the left) are the robot's forces on the clamp.
    """

    thrust: str = "+Fx"
    recoil: str = "+Fy"

    def __post_init__(self) -> None:
        allowed = [sign + axis for axis in AXES[:3] for sign in "+-"]
        for name, axis in (("thrust", self.thrust), ("recoil", self.recoil)):
            if axis not in allowed:
                raise RigError.value(f"force.{name}", repr(axis), ", ".join(allowed))
        if self.thrust[1:] == self.recoil[1:]:
            raise RigError.value("force.recoil", repr(self.recoil), "another axis than thrust's")

    def thrust_and_recoil(self, wrench: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns thrust and recoil (...) [N] of wrenches (..., 6)."""

        def along(axis: str) -> np.ndarray:
            return (-1.0 if axis[0] == "-" else 1.0) * wrench[..., AXES.index(axis[1:])]

        return along(self.thrust), along(self.recoil)


class Calibration(Protocol):
    """Conversion of raw records into forces."""

    def wrench(self, raw: np.ndarray, /) -> np.ndarray:
        """Returns forces [N] and torques [N m] (..., 6) from counts or volts (..., 6)."""
        ...

    def forces(self, host_ns: Sequence[int], datagrams: Sequence[bytes]) -> Forces:
        """Returns the forces of one recording; the arguments are in order of arrival."""
        ...


class Health(NamedTuple):
    """Numbers of records or samples since `start`."""

    received: int
    missing: int
    saturated: int


class ForceSource(ABC):
    """An open sensor. This context manager closes the sensor at the end or after an error."""

    calibration: Calibration
    _last: tuple[int, np.ndarray] | None = None

    @abstractmethod
    def start(self, sink: Sink) -> None:
        """Starts the stream. Raises `RigError` if no first record arrives."""

    @abstractmethod
    def bias(self) -> None:
        """Sets the present load as zero. Call this function at rest, before a recording."""

    def latest(self) -> tuple[int, np.ndarray] | None:
        """Returns arrival [ns] and wrench (6,) [N, N m] of the last record (None: no record)."""
        if self._last is None:
            return None
        now, raw = self._last
        return now, self.calibration.wrench(raw)

    @abstractmethod
    def health(self) -> Health:
        """Returns the numbers of records or samples since `start`."""

    @abstractmethod
    def check(self) -> None:
        """Raises `RigError` if the stream failed, sends no data, or reports an error."""

    @abstractmethod
    def stop(self) -> None:
        """Ends the stream, if a stream runs."""

    @abstractmethod
    def close(self) -> None:
        """Stops the stream and releases the sensor."""

    def __enter__(self) -> "ForceSource":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


@dataclass
class ReaderThread:
    """A thread that passes the results of `receive` to `take(host time [ns], bytes)`.

    `receive` waits a short time and returns None without data. An exception in `receive` or `take`
    ends the thread. `check` then raises this exception.
    """

    name: str
    receive: Callable[[], bytes | None]
    take: Callable[[int, bytes], None]
    patience: float
    """Time without data after which `check` raises an error [s]."""
    last_ns: int = field(default_factory=time.monotonic_ns)
    _failure: BaseException | None = None
    _ending: Event = field(default_factory=Event)
    _abandoned: Event = field(default_factory=Event)

    def __post_init__(self) -> None:
        self._thread = Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            while not self._abandoned.is_set():
                content = self.receive()
                now = time.monotonic_ns()
                if content is not None:
                    self.last_ns = now
                    self.take(now, content)
                elif self._ending.is_set():
                    return
        except BaseException as error:
            self._failure = error

    def check(self) -> None:
        """Raises the exception that ended the thread, or `RigError` if no data arrive."""
        if isinstance(self._failure, RigError):
            raise self._failure
        if self._failure is not None:
            raise RigError(f"{self.name}: stopped reading: {self._failure!r}") from self._failure
        silent = 1e-9 * (time.monotonic_ns() - self.last_ns)
        if silent > self.patience:
            raise RigError(
                f"{self.name}: no data for {silent:.1f} s; check the sensor's power and cable, and "
                "that no other computer or program requested the stream; then start again"
            )

    def end(self, wait: float) -> bool:
        """Ends the thread once no data arrive. Returns True if it ends within `wait` [s]."""
        self._ending.set()
        self._thread.join(wait)
        return not self._thread.is_alive()

    def abandon(self) -> None:
        """Ends the thread even while data arrive."""
        self._abandoned.set()
        self._thread.join()


def force_reader(calibration: Calibration, mounting: SensorMounting) -> StreamReader:
    """Returns the reader that converts a force sensor's stream to thrust_N and recoil_N."""

    def read(stream: RecordedStream) -> SampledColumns:
        forces = calibration.forces(stream.host_ns.tolist(), stream.pieces())
        valid = np.where(forces.doubtful[:, None], np.nan, forces.wrench)
        thrust, recoil = mounting.thrust_and_recoil(valid)
        columns = {"thrust_N": thrust, "recoil_N": recoil}
        return SampledColumns(forces.t_ns * 1e-9, columns, forces.findings)

    return read
