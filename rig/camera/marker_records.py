"""Binary records of the marker positions, one record per camera frame."""

import struct
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from rig.errors import RigError

HEADER = struct.Struct("<IQB")
"""Header of a record: frame number, time by the source's clock [ns], number of markers."""
POINT = np.dtype("<f4")
"""Type of the numbers after the header. The numbers are x [px], y [px] and quality of each marker,
in the order from tip to head. The numbers of a lost marker are NaN, NaN, 0."""


def pack_record(number: int, source_ns: int, points: np.ndarray) -> bytes:
    """Returns the record of a frame; `points` (markers, 3) are x, y [px], quality."""
    return HEADER.pack(number, source_ns, len(points)) + points.astype(POINT).tobytes()


class Tracks(NamedTuple):
    """Marker tracks as arrays; a lost marker has NaN positions and quality 0."""

    number: np.ndarray
    """(frames,) frame numbers; a missing number is a dropped frame."""
    source_ns: np.ndarray
    """(frames,) times by the source's clock [ns]"""
    xy: np.ndarray
    """(frames, markers, 2) positions [px]"""
    quality: np.ndarray
    """(frames, markers) quality, as in `rig.camera.markers.Marker`"""


def read_records(records: Iterable[bytes]) -> Tracks:
    """Returns the tracks in `records`.

    Raises `RigError` if a record is incomplete, or if the number of markers changes.
    """
    heads: list[tuple[int, int]] = []
    points: list[np.ndarray] = []
    for i, record in enumerate(records):
        markers = record[HEADER.size - 1] if len(record) >= HEADER.size else -1
        if len(record) != HEADER.size + 3 * POINT.itemsize * markers:
            raise RigError(f"camera record {i}: incomplete ({len(record)} bytes); repeat the trial")
        if points and points[0].size != 3 * markers:
            raise RigError.value(
                f"camera record {i}", f"{markers} markers", f"{len(points[0])}, as in record 0"
            )
        heads.append(HEADER.unpack_from(record)[:2])
        points.append(np.frombuffer(record, POINT, offset=HEADER.size).reshape(-1, 3))
    number, source_ns = np.array(heads, np.int64).reshape(-1, 2).T
    found = np.array(points, float) if points else np.empty((0, 0, 3))
    return Tracks(number, source_ns, found[..., :2], found[..., 2])
