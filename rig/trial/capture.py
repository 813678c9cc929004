"""One trial: quiet, the drive, quiet again; all streams in one recording, and a vent at the end."""

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
from rig.recording.writer import RecorderLoad
from rig.recording.writer_process import ProcessRecorder
from rig.trial.player import RATE, PlaybackRecord, play_drive, wait_until
from rig.trial.waveform import SegmentDrive

Sink = Callable[[int, bytes], None]


class RecordedInstrument(Protocol):
    """What is recorded beside the manifold: a force sensor, a camera."""

    def start(self, sink: Sink) -> None:
        """Hands (host time [ns], bytes) to `sink` from now on."""
        ...

    def stop(self) -> None:
        """Ends that."""
        ...

    def check(self) -> None:
        """Raises `RigError` where it fell silent or fails."""
        ...

    def close(self) -> None:
        """Ends it for good."""
        ...


class TrialTiming(NamedTuple):
    """Of a trial [s], and its commands a second."""

    quiet: float = 1.0
    """At rest before the drive, from which tares and noise are taken."""
    after: float = 0.3
    rate: float = RATE
    fade: float = 2.0
    """After the trial, over which the drive dies away."""


@dataclass(frozen=True)
class PlannedTrial:
    """What is played: `name` is that of its files, without a suffix."""

    name: str
    drive: SegmentDrive
    duration: float
    """[s]"""

    def check(self, limits: PressureLimits) -> None:
        """Raises `RigError`, naming the trial, if a chamber is ever asked for too much."""
        try:
            self.drive.check(limits, self.duration)
        except RigError as error:
            raise RigError(f"trial {self.name}: {error}") from None


class RecordedTrial(NamedTuple):
    """A trial that is on disk."""

    played: PlaybackRecord
    load: RecorderLoad


class SwitchableSink:
    """A sink that can be connected to another one, and drops what comes while it is not."""

    def __init__(self) -> None:
        self.to: Sink | None = None

    def __call__(self, host_ns: int, piece: bytes) -> None:
        to = self.to
        if to is not None:
            to(host_ns, piece)


class ManifoldSinks(NamedTuple):
    """Where the manifold's bytes go, in and out."""

    came: SwitchableSink
    went: SwitchableSink

    def disconnect(self) -> None:
        """What comes from now on is dropped."""
        self.came.to = self.went.to = None


def record_trial(
    trial: PlannedTrial,
    manifold: Manifold,
    switches: ManifoldSinks,
    instruments: dict[str, RecordedInstrument],
    path: Path,
    limits: PressureLimits,
    settings: dict[str, Any],
    timing: TrialTiming = TrialTiming(),
    watch: Callable[[str, float], None] = lambda phase, t: None,
) -> RecordedTrial:
    """Records a trial to `path`; `instruments` are by the name of their stream.

    Its end, whichever it is, vents the manifold before anything else. `watch` hears, a hundred
    times a second or so, what is done and its time [s]. Raises `RigError`.
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
            stack.callback(switches.disconnect)
            switches.came.to, switches.went.to = (
                recorder.sink("manifold"),
                recorder.sink("commands"),
            )
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
