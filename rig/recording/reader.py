"""Reads what `rig.recording.writer` wrote: while it is written, after its end, and after it was
killed."""

import json
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import h5py
import numpy as np

from rig.errors import RigError
from rig.recording.writer import CRC_OF_NOTHING, SCHEMA, open_to_read


class RecordedStream(NamedTuple):
    """What came on one stream: (pieces,) arrays and the bytes."""

    host_ns: np.ndarray
    """Host time of each piece [ns]."""
    ends: np.ndarray
    """Where each piece ends in `data`."""
    data: bytes
    lost: tuple[int, int]
    """Pieces and bytes that came but that the recorder could not keep."""
    trimmed: tuple[int, int]
    """Pieces and bytes at the end of the file that are not whole, and left out here."""

    def pieces(self) -> list[bytes]:
        """Each piece as it came."""
        starts = [0, *self.ends.tolist()]
        return [self.data[a:b] for a, b in zip(starts, starts[1:], strict=False)]


class Recording(NamedTuple):
    """All streams of a trial, by name, and what was known when it began."""

    streams: dict[str, RecordedStream]
    settings: dict[str, Any]
    versions: dict[str, str]
    wall_ns_at_host_0: int
    """Unix time [ns] of host time 0."""
    closed: bool
    """The recorder ended as it should; else it was killed, its disk failed, or it still runs."""


def read_recording(path: Path | str) -> Recording:
    """Return the recording at `path`; its end may be missing (see `RecordedStream.trimmed`).

    Raises `RigError` if the file is missing, torn, of a newer schema, or not a recording.
    """
    path = Path(path)
    try:
        with open(path, "rb"):
            pass
    except OSError as error:
        raise RigError(f"recording {path}: cannot be read ({error.strerror})") from None
    try:
        with open_to_read(path) as file:
            schema = int(file.attrs.get("schema", 0))
            if schema == SCHEMA:
                return _read(file)
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise RigError(
            f"recording {path}: is torn, or no recording at all ({error}); give a file that "
            "the rig's recorder wrote, and all of it"
        ) from None
    if schema > SCHEMA:
        raise RigError.value(
            f"recording {path}: schema", schema, f"up to {SCHEMA}", "read it with a newer version"
        )
    raise RigError(f"recording {path}: is HDF5, but not one of the rig's recorder; give another")


def _read(file: h5py.File) -> Recording:
    return Recording(
        {name: _stream(group) for name, group in file["streams"].items()},
        json.loads(file.attrs["settings"]),
        json.loads(file.attrs["versions"]),
        int(file.attrs["wall_ns_at_host_0"]),
        bool(file["closed"][()]),
    )


def _stream(group: h5py.Group) -> RecordedStream:
    index = group["index"][:]  # before the bytes, which may be growing
    data = group["bytes"][:].tobytes()
    good, end, crc = 0, 0, CRC_OF_NOTHING
    for _, next_end, next_crc in index.tolist():
        if not end <= next_end <= len(data):
            break
        crc = crc32(data[end:next_end], crc)
        if crc != next_crc:
            break
        good, end = good + 1, next_end
    pieces, size = group["lost"][:].tolist()
    return RecordedStream(
        index[:good, 0],
        index[:good, 1],
        data[:end],
        (pieces, size),
        (len(index) - good, len(data) - end),
    )
