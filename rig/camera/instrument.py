"""Camera that finds, tracks and records the robot's markers during a trial."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from rig.camera.marker_records import read_records
from rig.camera.markers import MarkerCriteria, find_markers
from rig.camera.scale import Scale, tip_excursion
from rig.camera.source import Camera, Frame, Source, record_markers
from rig.camera.tracking import Tracker, order_at_rest, smallest_distance
from rig.errors import RigError
from rig.recording.clock import Sink
from rig.recording.reader import RecordedStream
from rig.recording.table import SampledColumns, StreamReader

REST_FRAMES = 20
"""Number of frames at rest. At least one of these frames must show all markers."""
MIN_SEEN = 0.8
"""The reader reports a finding if a smaller fraction of the frames shows the tip."""


@dataclass(frozen=True)
class MarkerLayout:
    """Number of the robot's markers, and position of the head in the image at rest."""

    markers: int
    head: tuple[float, float]
    """Position in the image of a point in front of the head's marker [px]."""
    gate: float | None = None
    """Largest motion of a marker between frames [px]. The default is slightly less than half of
    the smallest distance between two markers, so that markers cannot be confused."""
    criteria: MarkerCriteria = MarkerCriteria()


class MarkerCamera:
    """An instrument (`start`, `stop`, `check`) that records the marker positions in every frame.

    `open_source` opens the camera for each trial. Raises `RigError` if the camera does not open.
    """

    def __init__(self, open_source: Callable[[], Source], layout: MarkerLayout):
        self._open, self._layout = open_source, layout
        self._failure: BaseException | None = None
        self._camera: Camera | None = None
        self._thread: threading.Thread | None = None

    def start(self, sink: Sink) -> None:
        """Finds the markers of the robot at rest, and starts to track them."""
        self._failure = None
        self._camera = Camera(self._open())
        try:
            frames = iter(self._camera)
            rest = self._find_at_rest(frames)
            tracker = Tracker(rest, self._layout.gate or 0.499 * smallest_distance(rest))
        except BaseException:
            self.stop()
            raise
        arguments = (frames, tracker, sink)
        self._thread = threading.Thread(target=self._track, args=arguments, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stops tracking and closes the camera, if the camera is open."""
        if self._camera is not None:
            self._camera.close()
        if self._thread is not None:
            self._thread.join()
        self._camera = self._thread = None

    def check(self) -> None:
        """Raises the error that ended the tracking, such as an unplugged camera."""
        if isinstance(self._failure, RigError):
            raise self._failure
        if self._failure is not None:
            raise RigError(f"camera: stopped: {self._failure!r}") from self._failure

    def close(self) -> None:
        """Stops tracking and closes the camera."""
        self.stop()

    def _find_at_rest(self, frames: Iterator[Frame]) -> np.ndarray:
        seen = 0
        for frame, _ in zip(frames, range(REST_FRAMES), strict=False):
            found = find_markers(frame.image, self._layout.criteria)
            seen = max(seen, len(found))
            if len(found) == self._layout.markers:
                return order_at_rest(found, self._layout.markers, self._layout.head)
        raise RigError(
            f"camera: at most {seen} markers found, {self._layout.markers} expected; check light "
            "and focus, or camera.markers in the rig file"
        )

    def _track(self, frames: Iterator[Frame], tracker: Tracker, sink: Sink) -> None:
        try:
            record_markers(frames, tracker, sink, self._layout.criteria)
        except BaseException as error:
            self._failure = error


def camera_reader(scale: Scale) -> StreamReader:
    """Returns a function that converts a camera's stream to the column tip_m, the excursion [m]."""

    def read(stream: RecordedStream) -> SampledColumns:
        tracks = read_records(stream.pieces())
        if not len(tracks.number):
            raise RigError("camera: the recording has no frames; check the camera and record again")
        rest = np.nanmedian(tracks.xy[: max(REST_FRAMES, 1)], axis=0)
        tip = tip_excursion(tracks.xy, scale.along(rest))
        seen = float(np.isfinite(tip).mean()) if len(tip) else 0.0
        findings = []
        # Frames before the first record were used to find the markers, so they were not dropped.
        dropped = int(tracks.number[-1] - tracks.number[0] + 1 - len(tracks.number))
        if dropped:
            findings.append(f"{dropped} camera frames were dropped")
        if seen < MIN_SEEN:
            findings.append(f"the tip was found in only {100 * seen:.0f} % of the frames")
        return SampledColumns(
            stream.host_ns * 1e-9, {"tip_m": tip}, tuple(findings), continuous=False
        )

    return read
