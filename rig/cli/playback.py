"""Plays a drive in a thread, while the main thread processes the live stream of readings."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np

from rig.cli.settings import ForceTable, RigTable
from rig.cli.shared import open_force_sensor
from rig.force import ati_rdt as rdt
from rig.force.sensor import ForceSource, SensorMounting
from rig.manifold.driver import Manifold
from rig.manifold.limits import PressureLimits
from rig.manifold.serial_port import open_port
from rig.scheduling import real_time_priority
from rig.trial.capture import PlannedTrial
from rig.trial.live_stream import LiveStream
from rig.trial.player import play_drive


class DrivePlayer:
    """A context manager that plays a drive for `duration` [s] in a thread with real-time priority.

    `stream` receives the readings and forces. At the end all chambers vent. Raises `RigError`
    at the start of the block, in `ended`, and at the end of the block.
    """

    def __init__(self, port: str, settings: RigTable, trial: PlannedTrial, duration: float):
        self._port, self._settings = port, settings
        self._trial = replace(trial, duration=duration)
        self._failure: BaseException | None = None
        analogue = tuple(x.sensor() for x in settings.analogue)
        self.stream = LiveStream(trial.drive.layout, analogue, settings.force is not None)
        self._stop, self._begun = threading.Event(), threading.Event()
        self.lost = 0
        """Number of lost readings of the manifold."""
        self._force: ForceSource | None = None
        self._thread = threading.Thread(target=self._play, name="player", daemon=True)

    @property
    def ended(self) -> bool:
        """Whether the drive has ended. Raises the error if an error ended the drive."""
        if not self._thread.is_alive() and self._failure is not None:
            raise self._failure
        return not self._thread.is_alive()

    def __enter__(self) -> "DrivePlayer":
        try:
            self._thread.start()
            while not self._begun.wait(0.05) and self._thread.is_alive():
                pass
        except BaseException as error:
            self._end_after(error)
            raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._end_after(error)

    def _end_after(self, error: BaseException | None) -> None:
        """Ends the thread, which vents. Raises the thread's error, or adds its text to `error`."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()
        if self._failure is None or error is self._failure:
            return
        if error is None:
            raise self._failure
        error.add_note(str(self._failure))

    def _play(self) -> None:
        try:
            with suppress(_Ended):
                self._run()
        except BaseException as error:
            self._failure = error

    def _run(self) -> None:
        layout, given = self._trial.drive.layout, self._settings.manifold.limits
        limits = PressureLimits.of(given, layout, "manifold.limits of the rig file")
        self._trial.check(limits)
        stream = self.stream
        manifold = Manifold(
            open_port(self._port), on_reading=stream.reading, on_follows=stream.follows
        )
        with real_time_priority(), manifold as m:
            stream.manifold = m
            m.configure(limits)
            with _forces(self._settings.force, stream) as self._force:
                m.arm()
                self._begun.set()
                rate = self._settings.manifold.commands_per_second
                try:
                    play_drive(stream, self._trial.drive, self._trial.duration, rate, self._tick)
                except BaseException as error:
                    m.stop_after(error)
                    raise
                m.stop()  # vents now, because closing the force sensor takes time

    def _tick(self, t: float) -> None:
        assert self.stream.manifold is not None
        self.lost = self.stream.manifold.lost
        if self._force is not None:
            self._force.check()
        if self._stop.is_set():
            raise _Ended


class _Ended(Exception):
    """The block of the context manager ended before the end of the drive."""


@contextmanager
def _forces(table: ForceTable | None, stream: LiveStream) -> Iterator[ForceSource | None]:
    """Opens the force sensor of `table`, if given, and passes the samples to the stream."""
    if table is None:
        yield None
        return
    source, _ = open_force_sensor(table)
    mounting, box = SensorMounting(table.thrust, table.recoil), rdt.BoxTime()

    def sink(host_ns: int, datagram: bytes) -> None:
        _, ft_seq, status, *counts = rdt.RECORD.unpack(datagram)
        sensor_s = box.seconds(ft_seq)
        if sensor_s is None:
            return
        wrench = source.calibration.wrench(np.array(counts))
        if rdt.is_invalid(status):
            wrench = np.full(6, np.nan)
        thrust, recoil = mounting.thrust_and_recoil(wrench)
        stream.force(host_ns, sensor_s, float(thrust), float(recoil))

    with source:
        source.start(sink)
        yield source
