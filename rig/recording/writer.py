"""Writes one HDF5 file per trial with the received bytes and the times of arrival.

The file remains readable if the writer is killed. The bytes of one read are called a piece.

| in the file | content |
|---|---|
| attributes | `schema`; `settings`, `versions` (JSON); `wall_ns_at_host_0` (Unix time [ns]) |
| `closed` | 1 after the recorder has ended normally |
| `streams/NAME/bytes` | uint8 (bytes,): the concatenated pieces |
| `streams/NAME/index` | int64 (pieces, 3): host time [ns], end offset, CRC-32 up to that end |
| `streams/NAME/lost` | int64 (2,): pieces and bytes that arrived but could not be written |

The file follows HDF5's rules for a single writer and many readers (SWMR). `rig.recording.reader`
can therefore read the file at any time. The recorder writes the bytes before the index. The CRC
shows whether bytes and index match.
"""

import ctypes
import json
import os
import platform
import re
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from importlib import metadata
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, Self
from zlib import crc32

import h5py
import numpy as np
from h5py import h5f, h5p
from h5py._objects import phil

from rig.errors import RigError
from rig.recording.clock import Sink

SCHEMA = 1
STREAMS = ("manifold", "force", "camera", "commands")
FLUSH_INTERVAL = 0.05
"""Time between two writes to disk [s]. A killed recorder loses at most the data of this time."""
MAX_WAITING = 64 * 2**20
"""Largest number of bytes of a stream that wait for the disk. Further pieces are lost."""
CRC_OF_NOTHING = 1
"""Initial value of the CRC. With 0, an index that contains only zeros would be valid."""
_BYTES_A_CHUNK, _ROWS_A_CHUNK = 16384, 512
"""Chunk sizes of the datasets `bytes` and `index`. A chunk contains at least 0.25 s of the
manifold's data, because HDF5 extends an existing chunk faster than it creates a chunk."""
_ATTEMPTS = 27
"""Number of HDF5's attempts to read metadata that a writer may be changing. The wait doubles after
each attempt, to 0.1 s in total. With the default of 100, an incomplete file would block readers."""


class RecorderLoad(NamedTuple):
    """The load of a recorder. All counts are numbers of pieces."""

    recorded: dict[str, int]
    """Pieces on disk, by stream."""
    lost: dict[str, int]
    """Lost pieces, by stream. A piece is lost if too many bytes wait or the recorder has ended."""
    waiting: int
    """Pieces of all streams that wait for the disk."""
    slowest_flush: float
    """Longest time between the ends of two writes to disk [s]; `FLUSH_INTERVAL` on a fast disk."""


class _Stream:
    """A stream's waiting pieces and datasets. A tally is a pair: number of pieces and of bytes."""

    def __init__(self, group: h5py.Group, max_waiting: int) -> None:
        self.bytes, self.index, self.tally = group["bytes"], group["index"], group["lost"]
        self.lock = threading.Lock()
        self.waiting: list[tuple[int, bytes]] = []
        self.size, self.max_size = 0, max_waiting
        self.received = self.recorded = self.lost = self.written_lost = (0, 0)
        self.crc = CRC_OF_NOTHING

    def put(self, host_ns: int, piece: bytes) -> None:
        with self.lock:
            self.received = _add_piece(self.received, piece)
            if self.size + len(piece) > self.max_size:
                self.lost = _add_piece(self.lost, piece)
            else:
                self.waiting.append((host_ns, bytes(piece)))
                self.size += len(piece)

    def shut(self) -> None:
        """Counts all further pieces as lost."""
        with self.lock:
            self.max_size = -1

    def give_up(self) -> None:
        """Counts all pieces that are not on disk as lost."""
        with self.lock:
            self.waiting, self.size, self.max_size = [], 0, -1
            self.lost = (self.received[0] - self.recorded[0], self.received[1] - self.recorded[1])

    def write(self) -> None:
        """Writes the waiting bytes to disk, then the index of these bytes."""
        with self.lock:
            pieces, self.waiting, self.size = self.waiting, [], 0
            lost = self.lost
        if pieces:
            (count, start), crc = self.recorded, self.crc
            end, rows = start, []
            for host_ns, piece in pieces:
                end, crc = end + len(piece), crc32(piece, crc)
                rows.append((host_ns, end, crc))
            content = b"".join(piece for _, piece in pieces)
            _append(self.bytes, start, np.frombuffer(content, np.uint8))
            _append(self.index, count, np.array(rows, np.int64))
            self.recorded, self.crc = (count + len(pieces), end), crc
        if lost != self.written_lost:
            self.tally[:] = lost
            self.tally.flush()
            self.written_lost = lost


def _add_piece(tally: tuple[int, int], piece: bytes) -> tuple[int, int]:
    return tally[0] + 1, tally[1] + len(piece)


class AbstractRecorder(ABC):
    """A context manager that closes the recorder at the end, and raises a failure only once."""

    _failure: RigError | None = None
    _raised = False

    @abstractmethod
    def close(self) -> None:
        """Writes the waiting pieces and ends. Raises `RigError`."""

    def _raise_failure(self) -> None:
        if self._failure is not None and not self._raised:
            self._raised = True
            raise self._failure

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            self.close()
        except RigError as failure:
            if error is None:
                raise
            error.add_note(str(failure))


class Recorder(AbstractRecorder):
    """A context manager that records named streams to `path` until it is closed.

    `settings` is stored as JSON. If the disk fails, the recorder's thread immediately calls
    `on_failure`, for example to vent. The data recorded before the failure are kept.

    Raises `RigError` if `path` exists or cannot be created, if `settings` is not JSON, or if a
    stream's name is not an identifier.
    """

    def __init__(
        self,
        path: Path | str,
        streams: Iterable[str] = STREAMS,
        settings: Mapping[str, Any] | None = None,
        on_failure: Callable[[RigError], None] = lambda failure: None,
        max_waiting: int = MAX_WAITING,
    ) -> None:
        self.path = Path(path)
        _create(self.path, tuple(streams), settings or {})
        self._file = open_to_write(self.path)
        self._streams = {
            name: _Stream(group, max_waiting) for name, group in self._file["streams"].items()
        }
        self._on_failure = on_failure
        self._slowest = 0.0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def sink(self, stream: str) -> Sink:
        """Returns a function `sink(host_ns, piece)` that records a piece.

        Any thread may call `sink`, which never waits. Raises `RigError` for an unknown stream.
        """
        if stream not in self._streams:
            raise RigError.value("stream", repr(stream), ", ".join(self._streams))
        return self._streams[stream].put

    def load(self) -> RecorderLoad:
        """Returns the recorder's present load."""
        streams = self._streams.items()
        return RecorderLoad(
            {name: stream.recorded[0] for name, stream in streams},
            {name: stream.lost[0] for name, stream in streams},
            sum(len(stream.waiting) for _, stream in streams),
            self._slowest,
        )

    def check(self) -> None:
        """Raises `RigError` if the disk failed. Later calls do not raise this error again."""
        self._raise_failure()

    def close(self) -> None:
        """Writes the waiting pieces and ends. Raises `RigError` if the disk failed."""
        self._ending.set()
        self._thread.join()
        self.check()

    def _work(self) -> None:
        last = time.monotonic()
        try:
            while not self._ending.wait(FLUSH_INTERVAL):
                self._write()
                now = time.monotonic()
                self._slowest, last = max(self._slowest, now - last), now
            for stream in self._streams.values():
                stream.shut()
            self._write()
            self._file["closed"][()] = 1
            self._file.close()
        except Exception as error:
            self._fail(error)

    def _write(self) -> None:
        for stream in self._streams.values():
            stream.write()

    def _fail(self, error: Exception) -> None:
        found = re.search(r"errno = (\d+)", str(error))
        self._failure = RigError(
            f"{self.path}: writing failed ({os.strerror(int(found[1])) if found else error}); the "
            "data written so far are kept; make room on the disk or use another one"
        )
        try:
            self._on_failure(self._failure)
        finally:
            for stream in self._streams.values():
                stream.give_up()
            _close_without_disk(self._file)


def _close_without_disk(file: h5py.File) -> None:
    """Closes the file, and redirects HDF5's last writes to memory.

    HDF5 cannot close a file on a failed disk. An open file would crash the process at its end.
    """
    with suppress(Exception):
        memory = os.memfd_create("recorder")
        os.dup2(memory, file.id.get_vfd_handle())
        os.close(memory)
        file.close()


def open_to_write(path: Path) -> h5py.File:
    """Returns the file, opened to write in SWMR mode from the start.

    h5py itself opens a file normally and then switches to SWMR. If the process were killed between
    these two steps, the file would block readers.
    """
    return _open_swmr(path, h5f.ACC_RDWR | h5f.ACC_SWMR_WRITE)


def open_to_read(path: Path) -> h5py.File:
    """Returns the file, opened to read, also if a recorder still writes the file or was killed."""
    return _open_swmr(path, h5f.ACC_RDONLY | h5f.ACC_SWMR_READ)


def _open_swmr(path: Path, flags: int) -> h5py.File:
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_libver_bounds(h5f.LIBVER_LATEST, h5f.LIBVER_LATEST)
    access.set_file_locking(False, True)  # with a lock, two programs could not open the file
    with phil, suppress(AttributeError):  # h5py lacks this function; Windows does not export it
        hdf5 = ctypes.PyDLL(h5p.__file__)
        hdf5.H5Pset_metadata_read_attempts(ctypes.c_int64(access.id), ctypes.c_uint(_ATTEMPTS))
    return h5py.File(h5f.open(str(path).encode(), flags, access))


def _append(dataset: h5py.Dataset, start: int, rows: np.ndarray) -> None:
    dataset.resize(start + len(rows), axis=0)
    dataset[start:] = rows
    dataset.flush()


def _create(path: Path, streams: tuple[str, ...], settings: Mapping[str, Any]) -> None:
    """Writes an empty recording to `path`, atomically."""
    if not streams or len(set(streams)) < len(streams) or not all(map(str.isidentifier, streams)):
        raise RigError.value("streams", streams, "identifiers without repetition")
    text = settings_json(path, settings)
    image = BytesIO()
    with h5py.File(image, "w", libver="latest") as file:
        file.attrs["schema"] = SCHEMA
        file.attrs["settings"] = text
        file.attrs["versions"] = json.dumps(_versions())
        file.attrs["wall_ns_at_host_0"] = time.time_ns() - time.monotonic_ns()
        file["closed"] = 0
        for name in streams:
            group = file.create_group(f"streams/{name}")
            group.create_dataset(
                "bytes", (0,), np.uint8, chunks=(_BYTES_A_CHUNK,), maxshape=(None,)
            )
            group.create_dataset(
                "index", (0, 3), np.int64, chunks=(_ROWS_A_CHUNK, 3), maxshape=(None, 3)
            )
            group["lost"] = np.zeros(2, np.int64)
    temporary = path.with_name(f".tmp-{os.getpid()}-{path.name}")
    try:
        if path.exists():
            raise RigError(
                f"recording {path}: exists already and is not overwritten; give another name for "
                "the recording"
            )
        temporary.write_bytes(image.getvalue())
        os.replace(temporary, path)
    except OSError as error:
        raise RigError(
            f"recording {path}: cannot be created ({error.strerror}); give another folder"
        ) from None
    finally:
        with suppress(OSError):
            temporary.unlink()


def settings_json(path: Path | str, settings: Mapping[str, Any]) -> str:
    """Returns `settings` as JSON. Raises `RigError` with `path` if this is not possible."""
    try:
        return json.dumps(settings, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise RigError(f"recording {path}: settings are not JSON ({error})") from None


def _versions() -> dict[str, str]:
    versions = {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "h5py": h5py.__version__,
        "hdf5": h5py.version.hdf5_version,
    }
    try:
        versions["slider-jax"] = metadata.version("slider-jax")
    except metadata.PackageNotFoundError:  # not installed
        pass
    return versions
