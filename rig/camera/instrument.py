"""A camera as an instrument of a trial: markers found at rest, followed, recorded, read back."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from rig.camera.marker_records import read_records
from rig.camera.markers import Look, find_markers
from rig.camera.scale import Scale, tip_excursion
from rig.camera.source import Camera, Frame, Source, record_markers
from rig.camera.tracking import Tracker, order_at_rest
from rig.errors import RigError
from rig.recording.clock import Sink
from rig.recording.reader import RecordedStream
from rig.recording.table import SampledColumns, StreamReader

LOOKS = 20
"""Frames at rest in which all markers have to be seen at once, or the camera sees them not."""
LEAST_SEEN = 0.8
"""Share of the frames in which the tip has to be seen."""


@dataclass(frozen=True)
class Sight:
    """How the markers lie at rest: their number, tip first, and where in the image the head is."""

    markers: int
    head: tuple[float, float]
    """[px], a place beyond the head's marker."""
    gate: float | None = None
    """Farthest that a marker goes from frame to frame [px]; by default as far as is clear whose it
    is, just below half of the least distance of two."""
    look: Look = Look()


class MarkerCamera:
    """An instrument (`start`, `stop`, `check`) that records its markers' places in every frame.

    `open_source` opens the camera anew for every trial. Raises `RigError` where it cannot.
    """

    def __init__(self, open_source: Callable[[], Source], sight: Sight):
        self._open, self._sight = open_source, sight
        self._failure: BaseException | None = None
        self._camera: Camera | None = None
        self._thread: threading.Thread | None = None

    def start(self, sink: Sink) -> None:
        """Finds the markers of the robot at rest, and follows them from now on."""
        self._failure = None
        self._camera = Camera(self._open())
        try:
            frames = iter(self._camera)
            rest = self._at_rest(frames)
            tracker = Tracker(rest, self._sight.gate or 0.499 * _least_distance(rest))
        except BaseException:
            self.stop()
            raise
        arguments = (frames, tracker, sink)
        self._thread = threading.Thread(target=self._work, args=arguments, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Ends it; nothing happens if it does not run."""
        if self._camera is not None:
            self._camera.close()
        if self._thread is not None:
            self._thread.join()
        self._camera = self._thread = None

    def check(self) -> None:
        """Raises what ended it, such as a camera that was unplugged."""
        if isinstance(self._failure, RigError):
            raise self._failure
        if self._failure is not None:
            raise RigError(f"camera: stopped: {self._failure!r}") from self._failure

    def close(self) -> None:
        """As `stop`."""
        self.stop()

    def _at_rest(self, frames: Iterator[Frame]) -> np.ndarray:
        seen = 0
        for frame, _ in zip(frames, range(LOOKS), strict=False):
            found = find_markers(frame.image, self._sight.look)
            seen = max(seen, len(found))
            if len(found) == self._sight.markers:
                return order_at_rest(found, self._sight.markers, self._sight.head)
        raise RigError(
            f"camera: {seen} markers are seen at most, {self._sight.markers} are expected; see to "
            "light and focus, or to camera.markers in the rig file"
        )

    def _work(self, frames: Iterator[Frame], tracker: Tracker, sink: Sink) -> None:
        try:
            record_markers(frames, tracker, sink, self._sight.look)
        except BaseException as error:
            self._failure = error


def _least_distance(places: np.ndarray) -> float:
    apart = np.hypot(*(places[:, None] - places).T)
    np.fill_diagonal(apart, np.inf)
    return float(apart.min())


def camera_reader(scale: Scale) -> StreamReader:
    """tip_m of a camera's stream: the tip's distance from the line of the robot at rest."""

    def read(stream: RecordedStream) -> SampledColumns:
        tracks = read_records(stream.pieces())
        if not len(tracks.number):
            raise RigError("camera: its recording has no frame; see that it runs, and record again")
        rest = np.nanmedian(tracks.xy[: max(LOOKS, 1)], axis=0)
        tip = tip_excursion(tracks.xy, scale.along(rest))
        seen = float(np.isfinite(tip).mean()) if len(tip) else 0.0
        findings = []
        # The first frames went to finding the markers.
        dropped = int(tracks.number[-1] - tracks.number[0] + 1 - len(tracks.number))
        if dropped:
            findings.append(f"{dropped} frames of the camera were dropped")
        if seen < LEAST_SEEN:
            findings.append(f"the tip was seen in {100 * seen:.0f} % of the frames only")
        return SampledColumns(
            stream.host_ns * 1e-9, {"tip_m": tip}, tuple(findings), continuous=False
        )

    return read
