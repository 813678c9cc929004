"""Frames of a camera or of a video file, each with its number and its time; markers of each.

A frame's number is counted by the source's own times, so that a frame that never came leaves a gap.
"""

import queue
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from rig.camera.marker_records import pack_record
from rig.camera.markers import Look, find_markers, import_opencv
from rig.camera.tracking import Tracker
from rig.errors import RigError
from rig.recording.clock import Sink

STALLED = 5.0
"""A live source that gives no frame for so long [s] is taken for gone."""


class Shot(NamedTuple):
    """What a source hands out."""

    source_ns: int
    """Time by the source's clock [ns]."""
    host_ns: int
    """Time by this computer's monotonic clock [ns]."""
    image: np.ndarray
    """BGR uint8 (height, width, 3)."""


class Frame(NamedTuple):
    """A shot with its number; the first is 0."""

    number: int
    source_ns: int
    host_ns: int
    image: np.ndarray


class Source(Protocol):
    """Where images come from."""

    name: str
    fps: float
    live: bool
    """Images come when they come; those that nobody takes are lost."""

    def read(self) -> Shot | None:
        """The next image; None at the end. Raises `RigError` where the source fails."""

    def close(self) -> None: ...


class OpenCvSource:
    """A video file (a path), or a device (its index), by OpenCV.

    A file's frames get the host's time at opening and their own time in the file after it.
    `fps` [Hz] is the rate at which images were taken, where device or file (slow motion) do not
    tell it. Raises `RigError`.
    """

    def __init__(self, source: Path | str | int, fps: float | None = None):
        cv2 = self._cv2 = import_opencv()
        self.live = isinstance(source, int)
        self.name = f"camera {source}" if self.live else str(source)
        if not isinstance(source, int) and not Path(source).is_file():
            raise RigError(f"{self.name}: there is no such file; give a video file")
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
                f"{self.name}: cannot be opened; is it plugged in, free and permitted to this user?"
                if self.live
                else f"{self.name}: is not a video that can be read, or is torn; record it again"
            )
        told = self._capture.get(cv2.CAP_PROP_FPS)
        self.fps = told if fps is None else fps
        if not 0 < self.fps < 1e5:
            self.close()
            raise RigError.value(f"{self.name}: fps", self.fps, "above 0 Hz", "give its rate")
        self._whole = 0 if self.live else round(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self._slower = 1.0 if self.live else told / self.fps
        self._opened, self._ends = time.monotonic_ns(), 0

    def read(self) -> Shot | None:
        """The next frame. Raises `RigError` where a device stops, or a file before its end."""
        good = self._capture.grab()
        now = time.monotonic_ns()
        image = self._capture.retrieve()[1] if good else None
        if image is None:
            if self.live:
                raise RigError(f"{self.name}: no more frames come; is it still plugged in?")
            if self._whole <= 0 or self._ends < self._whole:
                whole = self._whole if self._whole > 0 else "an unknown number, as never closed"
                raise RigError(
                    f"{self.name}: is torn: ends at frame {self._ends} of {whole}; record it again"
                )
            return None
        told = self._capture.get(self._cv2.CAP_PROP_POS_MSEC)
        source_ns = round(told * 1e6 * self._slower)
        if not self.live:
            self._ends = round(source_ns * 1e-9 * self.fps) + 1
            return Shot(source_ns, self._opened + source_ns, image)
        return Shot(source_ns if source_ns > 0 else now, now, image)

    def close(self) -> None:
        """Give the device or file back."""
        self._capture.release()


class Camera:
    """A thread that reads a source, so that a slow consumer does not hold it up.

    `for frame in camera` ends when the source does; a source's `RigError` is raised there. Of a
    live source the frames that find `room` others waiting are dropped. Use it in a `with`.
    """

    def __init__(self, source: Source, room: int = 32):
        self.source = source
        self.dropped = 0
        """Frames that never came or found no room, so far."""
        self._waiting: queue.Queue[Frame | int | BaseException] = queue.Queue(room)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._read, name=source.name, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Camera":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the thread, and the loop over the frames."""
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
        last, heard = -1, time.monotonic()
        while not self._closed.is_set():
            try:
                item = self._waiting.get(timeout=0.1)
            except queue.Empty:
                if self.source.live and time.monotonic() - heard > STALLED:
                    raise RigError(
                        f"{self.source.name}: no frame for {STALLED:g} s; is it still plugged in?"
                    ) from None
                continue
            heard = time.monotonic()
            if isinstance(item, BaseException):
                raise item
            if isinstance(item, int):
                self.dropped += item - last
                return
            self.dropped += item.number - last - 1
            last = item.number
            yield item


def frames_between(before: int | None, now: int, fps: float) -> int:
    """By how much the number rises from one shot [ns] to the next: 1 if none was dropped."""
    return 1 if before is None else max(1, round((now - before) * 1e-9 * fps))


def record_markers(
    camera: Iterable[Frame],
    tracker: Tracker,
    sink: Sink,
    look: Look = Look(),
) -> None:
    """Track the markers to the camera's end: `sink(host_ns, record)` for each frame."""
    last = -1
    for frame in camera:
        points = tracker.follow(find_markers(frame.image, look), frame.number - last)
        last = frame.number
        sink(frame.host_ns, pack_record(frame.number, frame.source_ns, points))
