"""Reads recordings, also if a recorder still writes the file or was killed."""

import json
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import h5py
import numpy as np

from rig.errors import RigError
from rig.recording.writer import CRC_OF_NOTHING, SCHEMA, open_to_read


class RecordedStream(NamedTuple):
    """Bytes of one stream, divided into received pieces. The arrays have the shape (pieces,)."""

    host_ns: np.ndarray
    """Arrival time of each piece on the host's clock [ns]."""
    ends: np.ndarray
    """Offset in `data` at which each piece ends."""
    data: bytes
    lost: tuple[int, int]
    """Numbers of pieces and bytes that arrived but could not be written."""
    trimmed: tuple[int, int]
    """Numbers of pieces and bytes that are omitted, because the file's end is incomplete."""

    def pieces(self) -> list[bytes]:
        """Returns the received pieces."""
        starts = [0, *self.ends.tolist()]
        return [self.data[a:b] for a, b in zip(starts, starts[1:], strict=False)]


class Recording(NamedTuple):
    """All streams of a trial by name, and the settings and versions at the start of the trial."""

    streams: dict[str, RecordedStream]
    settings: dict[str, Any]
    versions: dict[str, str]
    wall_ns_at_host_0: int
    """Unix time [ns] of host time 0."""
    closed: bool
    """False if the recorder was killed or still runs, or if the disk failed; otherwise True."""


def read_recording(path: Path | str) -> Recording:
    """Returns the recording at `path`. Omits incomplete pieces (`RecordedStream.trimmed`).

    Raises `RigError` if the file is missing, damaged, of a newer schema, or not a recording.
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
            f"recording {path}: is incomplete or not a recording ({error}); give a complete file "
            "that the rig's recorder wrote"
        ) from None
    if schema > SCHEMA:
        raise RigError.value(
            f"recording {path}: schema", schema, f"up to {SCHEMA}", "use a newer slider-jax"
        )
    raise RigError(f"recording {path}: is an HDF5 file but not a recording; give a recording")


def _read(file: h5py.File) -> Recording:
    return Recording(
        {name: _stream(group) for name, group in file["streams"].items()},
        json.loads(file.attrs["settings"]),
        json.loads(file.attrs["versions"]),
        int(file.attrs["wall_ns_at_host_0"]),
        bool(file["closed"][()]),
    )


def _stream(group: h5py.Group) -> RecordedStream:
    index = group["index"][:]  # read first, because a running recorder appends bytes
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
