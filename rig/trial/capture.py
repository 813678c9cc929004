"""Records one trial (rest, drive, rest) with all streams in one file, and vents the chambers."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from rig.errors import RigError
from rig.manifold.driver import Manifold
from rig.manifold.limits import PressureLimits
from rig.recording.clock import Sink
from rig.recording.writer import RecorderLoad
from rig.recording.writer_process import ProcessRecorder
from rig.trial.player import RATE, PlaybackRecord, play_drive, wait_until
from rig.trial.waveform import ChamberDrive


class RecordedInstrument(Protocol):
    """An instrument that is recorded with the manifold: a force sensor or a camera."""

    def start(self, sink: Sink) -> None:
        """Begins to call `sink` with (host time [ns], bytes)."""
        ...

    def stop(self) -> None:
        """Stops calling the function that was passed to `start`."""
        ...

    def check(self) -> None:
        """Raises `RigError` if the instrument failed or sends no data."""
        ...

    def close(self) -> None:
        """Releases the instrument."""
        ...


class TrialTiming(NamedTuple):
    """Durations of a trial's parts, and the rate of its commands."""

    quiet: float = 1.0
    """Duration of the rest before the drive, in which tares and noise are measured [s]."""
    after: float = 0.3
    """Duration of the rest after the drive [s]."""
    rate: float = RATE
    """Commands per second."""
    fade: float = 2.0
    """Time in which the amplitude decreases to 0 after the drive [s]."""


@dataclass(frozen=True)
class PlannedTrial:
    """A trial as the rig plays it."""

    name: str
    """Name of the trial's files, without a suffix."""
    drive: ChamberDrive
    duration: float
    """Duration of the drive without its fade [s]."""

    def check(self, limits: PressureLimits) -> None:
        """Raises `RigError` with the trial's name if a set pressure exceeds the chamber's limit."""
        try:
            self.drive.check(limits, self.duration)
        except RigError as error:
            raise RigError(f"trial {self.name}: {error}") from None


class RecordedTrial(NamedTuple):
    """Playback record of a recorded trial, and the amounts of data recorded, lost and waiting."""

    played: PlaybackRecord
    load: RecorderLoad


class SwitchableSink:
    """A sink that passes the data to the sink `to`, or drops the data if `to` is None."""

    def __init__(self) -> None:
        self.to: Sink | None = None

    def __call__(self, host_ns: int, piece: bytes) -> None:
        to = self.to
        if to is not None:
            to(host_ns, piece)


class ManifoldSinks(NamedTuple):
    """Sinks of the bytes from and to the manifold."""

    received: SwitchableSink
    sent: SwitchableSink

    def disconnect(self) -> None:
        """Drops all further bytes."""
        self.received.to = self.sent.to = None


def record_trial(
    trial: PlannedTrial,
    manifold: Manifold,
    sinks: ManifoldSinks,
    instruments: dict[str, RecordedInstrument],
    path: Path,
    limits: PressureLimits,
    settings: dict[str, Any],
    timing: TrialTiming = TrialTiming(),
    watch: Callable[[str, float], None] = lambda phase, t: None,
) -> RecordedTrial:
    """Records a trial to the file `path`, and returns what was played and recorded.

    `instruments` maps a stream's name to the instrument. When the drive ends or fails, the manifold
    vents before the instruments stop. `watch` is called after each command, and 100 times per
    second at rest, with the phase's name and the time since the phase began [s]. Raises `RigError`.
    """
    trial.check(limits)
    streams = ("manifold", "commands", *instruments)

    def check() -> None:
        manifold.check()
        recorder.check()
        for instrument in instruments.values():
            instrument.check()

    def wait(phase: str, seconds: float) -> None:
        ticks = np.arange(1, max(int(100 * seconds), 1) + 1) / 100
        start = time.monotonic()
        for t in ticks:
            wait_until(start + t)
            check()
            watch(phase, float(t))

    def on_tick(t: float) -> None:
        check()
        watch("drive", t)

    manifold.configure(limits)
    recorder = ProcessRecorder(path, streams, settings)
    with recorder:
        with ExitStack() as stack:
            stack.callback(sinks.disconnect)
            sinks.received.to = recorder.sink("manifold")
            sinks.sent.to = recorder.sink("commands")
            for name, instrument in instruments.items():
                instrument.start(recorder.sink(name))
                stack.callback(instrument.stop)
            wait("quiet", timing.quiet)
            try:
                manifold.arm()
                played = play_drive(
                    manifold, trial.drive, trial.duration, timing.rate, on_tick, timing.fade
                )
            except BaseException as error:
                manifold.stop_after(error)
                raise
            manifold.stop()
            wait("after", timing.after)
    return RecordedTrial(played, recorder.load())
