"""Reads numbered and timed frames from a camera or a video file, and records their markers.

Frame numbers are computed from the source's times, so a dropped frame leaves a gap.
"""

import queue
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from rig.camera.marker_records import pack_record
from rig.camera.markers import MarkerCriteria, find_markers, import_opencv
from rig.camera.tracking import Tracker
from rig.errors import RigError
from rig.recording.clock import Sink

STALLED = 5.0
"""Time without a frame after which a live source counts as unplugged [s]."""


class Shot(NamedTuple):
    """An image and its times."""

    source_ns: int
    """Time by the source's clock [ns]."""
    host_ns: int
    """Time by this computer's monotonic clock [ns]."""
    image: np.ndarray
    """BGR uint8 (height, width, 3)."""


class Frame(NamedTuple):
    """An image with times and the frame's number. The first frame has the number 0."""

    number: int
    source_ns: int
    host_ns: int
    image: np.ndarray


class Source(Protocol):
    """Source of images."""

    name: str
    fps: float
    live: bool
    """True for a device, which loses images that are not read in time; False for a file."""

    def read(self) -> Shot | None:
        """Returns the next image, None at the end. Raises `RigError` if the source fails."""

    def close(self) -> None: ...


class OpenCvSource:
    """A video file (given by a path) or a device (given by an index), read by OpenCV.

    The host time of a file's frame is the time of opening plus the frame's time in the file. `fps`
    [Hz] is the camera's true rate. Give `fps` if the file states a different rate (slow motion).
    Raises `RigError` if the source cannot be opened.
    """

    def __init__(self, source: Path | str | int, fps: float | None = None):
        cv2 = self._cv2 = import_opencv()
        self.live = isinstance(source, int)
        self.name = f"camera {source}" if self.live else str(source)
        if not isinstance(source, int) and not Path(source).is_file():
            raise RigError(f"{self.name}: no such file; give a video file")
        level = cv2.utils.logging.getLogLevel()
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        try:
            self._capture = (
                cv2.VideoCapture(source)
                if self.live
                else cv2.VideoCapture(str(source), cv2.CAP_FFMPEG)
            )
        finally:
            cv2.utils.logging.setLogLevel(level)
        if not self._capture.isOpened():
            raise RigError(
                f"{self.name}: cannot be opened; check plug, other programs and permissions"
                if self.live
                else f"{self.name}: not a readable video, or incomplete; record it again"
            )
        file_fps = self._capture.get(cv2.CAP_PROP_FPS)
        self.fps = file_fps if fps is None else fps
        if not 0 < self.fps < 1e5:
            self.close()
            raise RigError.value(f"{self.name}: fps", self.fps, "above 0 Hz", "set the true rate")
        self._length = 0 if self.live else round(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self._slower = 1.0 if self.live else file_fps / self.fps
        self._opened, self._ends = time.monotonic_ns(), 0

    def read(self) -> Shot | None:
        """Returns the next frame. Raises `RigError` if a device stops or a file is incomplete."""
        good = self._capture.grab()
        now = time.monotonic_ns()
        image = self._capture.retrieve()[1] if good else None
        if image is None:
            if self.live:
                raise RigError(f"{self.name}: no more frames; check the plug")
            if self._length <= 0 or self._ends < self._length:
                length = self._length if self._length > 0 else "an unknown number (never closed)"
                raise RigError(
                    f"{self.name}: incomplete: ends at frame {self._ends} of {length}; record it "
                    "again"
                )
            return None
        file_ms = self._capture.get(self._cv2.CAP_PROP_POS_MSEC)
        source_ns = round(file_ms * 1e6 * self._slower)
        if not self.live:
            self._ends = round(source_ns * 1e-9 * self.fps) + 1
            return Shot(source_ns, self._opened + source_ns, image)
        return Shot(source_ns if source_ns > 0 else now, now, image)

    def close(self) -> None:
        """Closes the device or file."""
        self._capture.release()


class Camera:
    """Context manager that reads a source in a thread, so slow processing does not delay reading.

    A loop `for frame in camera` ends when the source ends, and raises the source's errors. A frame
    of a live source is dropped if `room` frames are already waiting.
    """

    def __init__(self, source: Source, room: int = 32):
        self.source = source
        self.dropped = 0
        """Number of frames that the source dropped, or that were dropped by a full queue."""
        self._waiting: queue.Queue[Frame | int | BaseException] = queue.Queue(room)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._read, name=source.name, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Camera":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the thread and the loop over the frames."""
        self._closed.set()
        self._thread.join(STALLED)
        self.source.close()

    def _put(self, item: Frame | int | BaseException) -> None:
        while not self._closed.is_set():
            try:
                return self._waiting.put(item, timeout=0.1)
            except queue.Full:
                continue

    def _read(self) -> None:
        number, before = -1, None
        try:
            while not self._closed.is_set():
                shot = self.source.read()
                if shot is None:
                    return self._put(number)
                number += frames_between(before, shot.source_ns, self.source.fps)
                before = shot.source_ns
                frame = Frame(number, *shot)
                if not self.source.live:
                    self._put(frame)
                elif not self._waiting.full():
                    self._waiting.put_nowait(frame)
        except BaseException as error:
            self._put(error)

    def __iter__(self) -> Iterator[Frame]:
        last, last_frame = -1, time.monotonic()
        while not self._closed.is_set():
            try:
                item = self._waiting.get(timeout=0.1)
            except queue.Empty:
                if self.source.live and time.monotonic() - last_frame > STALLED:
                    raise RigError(
                        f"{self.source.name}: no frame for {STALLED:g} s; check the plug"
                    ) from None
                continue
            last_frame = time.monotonic()
            if isinstance(item, BaseException):
                raise item
            if isinstance(item, int):
                self.dropped += item - last
                return
            self.dropped += item.number - last - 1
            last = item.number
            yield item


def frames_between(before: int | None, now: int, fps: float) -> int:
    """Returns the difference of two images' frame numbers, from their times [ns]."""
    return 1 if before is None else max(1, round((now - before) * 1e-9 * fps))


def record_markers(
    camera: Iterable[Frame],
    tracker: Tracker,
    sink: Sink,
    criteria: MarkerCriteria = MarkerCriteria(),
) -> None:
    """Tracks the markers until `camera` ends. Calls `sink(host_ns, record)` for each frame."""
    last = -1
    for frame in camera:
        points = tracker.follow(find_markers(frame.image, criteria), frame.number - last)
        last = frame.number
        sink(frame.host_ns, pack_record(frame.number, frame.source_ns, points))
