"""What every force sensor gives: raw records to a sink while it runs, and forces from them after.

| sensor | source | calibration |
|---|---|---|
| ATI Net F/T box, by UDP | `rig.force.ati_net.NetForce` | `rig.force.ati_net.NetCalibration` |
| six gauges, NI card | `rig.force.ni_daq.GaugeForce` | `rig.force.ni_daq.GaugeCalibration` |

A sink is called in the source's own thread with the host's monotonic time of arrival [ns] and the
bytes as they came; a calibration's `forces` turns what a sink got into newtons at known times.
"""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from threading import Event, Thread
from types import TracebackType
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
"""One of a sensor's units, as ATI spells them but for case and hyphens."""


def unit_in_si(unit: str, known: dict[str, float], where: str) -> float:
    """Newtons or newton metres in one `unit`. Raises `RigError` for one that is not known."""
    spelt = unit.strip().lower().replace("-", "").replace(" ", "").replace("lbin", "lbfin")
    if spelt not in known:
        raise RigError.value(
            where, f"unit {unit!r}", ", ".join(known), "set the sensor to N and N-m, or convert"
        )
    return known[spelt]


def check_positive(where: str, **values: float) -> None:
    """Raise `RigError` for a value that is not a finite number above 0."""
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise RigError.value(f"{where}, {name}", value, "a number above 0")


class Forces(NamedTuple):
    """What a sensor measured."""

    t_ns: np.ndarray
    """(n,) host's monotonic clock [ns] when each was sampled, evenly spaced."""
    wrench: np.ndarray
    """(n, 6) forces [N] and torques [N m] in the order of `AXES`; NaN where the sample was lost."""
    doubtful: np.ndarray
    """(n,) True where saturated, stuck, or the sensor told an error."""
    findings: tuple[str, ...]
    """What a user should know of, a sentence each."""


@dataclass(frozen=True)
class SensorMounting:
    """How the sensor sits: which of its force axes, with sign, are the experiment's.

    Both are the robot's force on its clamp: thrust positive head first, recoil to its left.
    """

    thrust: str = "+Fx"
    recoil: str = "+Fy"

    def __post_init__(self) -> None:
        allowed = [sign + axis for axis in AXES[:3] for sign in "+-"]
        for name, axis in (("thrust", self.thrust), ("recoil", self.recoil)):
            if axis not in allowed:
                raise RigError.value(f"mounting.{name}", repr(axis), ", ".join(allowed))
        if self.thrust[1:] == self.recoil[1:]:
            raise RigError.value("mounting.recoil", repr(self.recoil), "another axis than thrust's")

    def thrust_and_recoil(self, wrench: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """thrust_N and recoil_N, (...), of wrenches (..., 6)."""

        def along(axis: str) -> np.ndarray:
            return (-1.0 if axis[0] == "-" else 1.0) * wrench[..., AXES.index(axis[1:])]

        return along(self.thrust), along(self.recoil)


class Calibration(Protocol):
    """What makes forces of raw records."""

    def wrench(self, raw: np.ndarray, /) -> np.ndarray:
        """Forces [N] and torques [N m], (..., 6), of counts or volts (..., 6)."""
        ...

    def forces(self, host_ns: Sequence[int], datagrams: Sequence[bytes]) -> Forces:
        """The forces of one recording, from what its sink got in order of arrival."""
        ...


class Health(NamedTuple):
    """Counts since `start`, of records or samples."""

    received: int
    missing: int
    saturated: int


class ForceSource(ABC):
    """A sensor, opened. As a context manager it stops and closes on every way out."""

    calibration: Calibration

    @abstractmethod
    def start(self, sink: Sink) -> None:
        """Begin; returns once the first record came. Raises `RigError` if none does."""

    @abstractmethod
    def bias(self) -> None:
        """Call the load of this moment zero. Do so before a recording, at rest."""

    @abstractmethod
    def latest(self) -> tuple[int, np.ndarray] | None:
        """Arrival [ns] and wrench (6,) [N, N m] of the last record; None before the first."""

    @abstractmethod
    def health(self) -> Health:
        """Counts so far."""

    @abstractmethod
    def check(self) -> None:
        """Raise `RigError` if the stream broke off, fell silent, or tells an error."""

    @abstractmethod
    def stop(self) -> None:
        """End the stream; nothing happens if there is none."""

    @abstractmethod
    def close(self) -> None:
        """Stop, and give the sensor back."""

    def __enter__(self) -> "ForceSource":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


@dataclass
class ReaderThread:
    """A thread that hands on what `receive` returns until it is told to end.

    `receive` waits a short time and returns None if nothing came. What it, or `take`, raises ends
    the thread and is raised again by `check`.
    """

    name: str
    receive: Callable[[], bytes | None]
    take: Callable[[int, bytes], None]
    patience: float
    """Longest silence [s] that `check` lets pass."""
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
        """Raise what ended the thread, or `RigError` after a silence."""
        if isinstance(self._failure, RigError):
            raise self._failure
        if self._failure is not None:
            raise RigError(f"{self.name}: stopped reading: {self._failure!r}") from self._failure
        silent = 1e-9 * (time.monotonic_ns() - self.last_ns)
        if silent > self.patience:
            raise RigError(
                f"{self.name}: fell silent {silent:.1f} s ago; see to its power and cable, and "
                "that no other computer or program asked for its stream; then start again"
            )

    def end(self, wait: float) -> bool:
        """Tell the thread to end at the next silence; True if it did within `wait` [s]."""
        self._ending.set()
        self._thread.join(wait)
        return not self._thread.is_alive()

    def abandon(self) -> None:
        """End the thread though more comes."""
        self._abandoned.set()
        self._thread.join()


def force_reader(calibration: Calibration, mounting: SensorMounting) -> StreamReader:
    """thrust_N and recoil_N of a force sensor's stream."""

    def read(stream: RecordedStream) -> SampledColumns:
        forces = calibration.forces(stream.host_ns.tolist(), stream.pieces())
        sound = np.where(forces.doubtful[:, None], np.nan, forces.wrench)
        thrust, recoil = mounting.thrust_and_recoil(sound)
        columns = {"thrust_N": thrust, "recoil_N": recoil}
        return SampledColumns(forces.t_ns * 1e-9, columns, forces.findings)

    return read
