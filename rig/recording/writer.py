"""One HDF5 file a trial: the bytes of every stream as they came, and when; safe against kill -9.

| in the file | what |
|---|---|
| attributes | `schema`; `settings`, `versions` (JSON); `wall_ns_at_host_0` (Unix time [ns]) |
| `closed` | 1 once the recorder has ended as it should |
| `streams/NAME/bytes` | uint8 (bytes,): the pieces end to end |
| `streams/NAME/index` | int64 (pieces, 3): host time [ns], end, CRC-32 of all up to there |
| `streams/NAME/lost` | int64 (2,): pieces and bytes that came but could not be kept |

The file follows HDF5's rules for a single writer and many readers (SWMR), so that
`rig.recording.reader`
can read it at any moment, also when its writer is gone. Bytes go to the disk before their index,
and the CRC tells whether they belong together.
"""

import ctypes
import json
import os
import platform
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from importlib import metadata
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import h5py
import numpy as np
from h5py import h5f, h5p
from h5py._objects import phil

from rig.errors import RigError

SCHEMA = 1
STREAMS = ("manifold", "force", "camera", "commands")
FLUSH_EVERY = 0.05
"""Between flushes [s]; what a killed recorder can lose."""
MAX_WAITING = 64 * 2**20
"""Bytes of one stream that may wait for the disk; what comes on top is counted as lost."""
CRC_OF_NOTHING = 1
"""Where the CRC begins: from 0 an index of zeros would pass for pieces without bytes."""
_BYTES_A_CHUNK, _ROWS_A_CHUNK = 16384, 512
"""A quarter of a second of a manifold or more: a flush writes the last chunk anew, which is less
work than making one, and with 4096 and 64 each made one."""

_ATTEMPTS = 27
"""HDF5 reads what looks damaged again, as a writer may be at it, and waits twice as long each time:
0.1 s in all. Its own hundred times would never end on a torn file."""


class RecorderLoad(NamedTuple):
    """How a recorder keeps up; counts are of pieces, of all streams unless told otherwise."""

    recorded: dict[str, int]
    """On disk, by stream."""
    lost: dict[str, int]
    """Came but could not be kept, by stream: too many were waiting, or the recorder had ended."""
    waiting: int
    max_waiting: int
    slowest_flush: float
    """Longest time from one flush to the end of the next [s]; `FLUSH_EVERY` if all is well."""


class _Stream:
    """What waits for the disk, and the datasets where it goes. Tallies are of pieces and bytes."""

    def __init__(self, group: h5py.Group, max_waiting: int) -> None:
        self.bytes, self.index, self.tally = group["bytes"], group["index"], group["lost"]
        self.lock = threading.Lock()
        self.waiting: list[tuple[int, bytes]] = []
        self.size, self.most = 0, max_waiting
        self.came = self.recorded = self.lost = self.told = (0, 0)
        self.crc = CRC_OF_NOTHING

    def put(self, host_ns: int, piece: bytes) -> None:
        with self.lock:
            self.came = _more(self.came, piece)
            if self.size + len(piece) > self.most:
                self.lost = _more(self.lost, piece)
            else:
                self.waiting.append((host_ns, bytes(piece)))
                self.size += len(piece)

    def shut(self) -> None:
        """From now on all that comes is lost."""
        with self.lock:
            self.most = -1

    def give_up(self) -> None:
        """All that is not on disk is lost."""
        with self.lock:
            self.waiting, self.size, self.most = [], 0, -1
            self.lost = (self.came[0] - self.recorded[0], self.came[1] - self.recorded[1])

    def write(self) -> None:
        """To disk: bytes, then the index of them."""
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
        if lost != self.told:
            self.tally[:] = lost
            self.tally.flush()
            self.told = lost


def _more(tally: tuple[int, int], piece: bytes) -> tuple[int, int]:
    return tally[0] + 1, tally[1] + len(piece)


class Recorder:
    """Records named streams to `path` until closed; a context manager.

    `settings` is anything JSON can hold. `on_failure` is called once, at once and in the recorder's
    own thread, when the disk fails (full, gone): the place to vent. Nothing that was recorded
    before suffers from that.

    Raises `RigError` if `path` exists or cannot be made, for settings that are not JSON, and for
    names that are not letters.
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
        self._failure: RigError | None = None
        self._told = False
        self._most_waiting, self._slowest = 0, 0.0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def sink(self, stream: str) -> Callable[[int, bytes], None]:
        """`sink(host_ns, piece)` records a piece; any thread may call it, and it never waits.

        Raises `RigError` for a stream that was not named at the start.
        """
        if stream not in self._streams:
            raise RigError.value("stream", repr(stream), ", ".join(self._streams))
        return self._streams[stream].put

    def load(self) -> RecorderLoad:
        """How the recorder keeps up."""
        streams = self._streams.items()
        return RecorderLoad(
            {name: stream.recorded[0] for name, stream in streams},
            {name: stream.lost[0] for name, stream in streams},
            sum(len(stream.waiting) for _, stream in streams),
            self._most_waiting,
            self._slowest,
        )

    def check(self) -> None:
        """Raises the disk's failure as `RigError`, if there was one and it was not raised yet."""
        if self._failure and not self._told:
            self._told = True
            raise self._failure

    def close(self) -> None:
        """Write what waits, and end. Raises as `check`; a second call does nothing."""
        self._ending.set()
        self._thread.join()
        self.check()

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            self.close()
        except RigError as failure:
            if error is None:
                raise
            error.add_note(str(failure))

    def _work(self) -> None:
        last = time.monotonic()
        try:
            while not self._ending.wait(FLUSH_EVERY):
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
        self._most_waiting = max(self._most_waiting, self.load().waiting)
        for stream in self._streams.values():
            stream.write()

    def _fail(self, error: Exception) -> None:
        found = re.search(r"errno = (\d+)", str(error))
        self._failure = RigError(
            f"{self.path}: cannot be written any more "
            f"({os.strerror(int(found[1])) if found else error}); what it holds is kept; "
            "make room on the disk, or record to another one"
        )
        try:
            self._on_failure(self._failure)
        finally:
            for stream in self._streams.values():
                stream.give_up()
            _close_without_disk(self._file)


def _close_without_disk(file: h5py.File) -> None:
    """Let HDF5 write its last words to memory: with a disk that fails it could not close, and would
    crash the process at its end."""
    with suppress(Exception):
        memory = os.memfd_create("recorder")
        os.dup2(memory, file.id.get_vfd_handle())
        os.close(memory)
        file.close()


def open_to_write(path: Path) -> h5py.File:
    """For SWMR at once: h5py's way is a plain opening first, which a kill turns into a bar."""
    return _open_swmr(path, h5f.ACC_RDWR | h5f.ACC_SWMR_WRITE)


def open_to_read(path: Path) -> h5py.File:
    """Also while it is written, and after its writer was killed."""
    return _open_swmr(path, h5f.ACC_RDONLY | h5f.ACC_SWMR_READ)


def _open_swmr(path: Path, flags: int) -> h5py.File:
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_libver_bounds(h5f.LIBVER_LATEST, h5f.LIBVER_LATEST)
    access.set_file_locking(False, True)  # locks would shut out whoever comes while another opens
    with phil, suppress(AttributeError):  # not in h5py; on Windows there is no way to it
        hdf5 = ctypes.PyDLL(h5p.__file__)
        hdf5.H5Pset_metadata_read_attempts(ctypes.c_int64(access.id), ctypes.c_uint(_ATTEMPTS))
    return h5py.File(h5f.open(str(path).encode(), flags, access))


def _append(dataset: h5py.Dataset, start: int, rows: np.ndarray) -> None:
    dataset.resize(start + len(rows), axis=0)
    dataset[start:] = rows
    dataset.flush()


def _create(path: Path, streams: tuple[str, ...], settings: Mapping[str, Any]) -> None:
    """The empty recording, all of it at once."""
    if not streams or len(set(streams)) < len(streams) or not all(map(str.isidentifier, streams)):
        raise RigError.value("streams", streams, "names of letters, each once")
    try:
        text = json.dumps(settings, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise RigError(f"recording {path}: settings are not JSON ({error})") from None
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
                f"recording {path}: exists already; no recording is overwritten: give another name"
            )
        temporary.write_bytes(image.getvalue())
        os.replace(temporary, path)
    except OSError as error:
        raise RigError(
            f"recording {path}: cannot be made ({error.strerror}); give another place"
        ) from None
    finally:
        with suppress(OSError):
            temporary.unlink()


def _versions() -> dict[str, str]:
    versions = {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "h5py": h5py.__version__,
        "hdf5": h5py.version.hdf5_version,
    }
    try:
        versions["slider-jax"] = metadata.version("slider-jax")
    except metadata.PackageNotFoundError:  # run from its source
        pass
    return versions
