"""What is recorded of each frame of the camera: where the markers were."""

import struct
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from rig.errors import RigError

HEADER = struct.Struct("<IQB")
"""Of a record: frame's number, time by the source's clock [ns], number of markers."""
POINT = np.dtype("<f4")
"""Then for each marker, tip first, x [px], y [px], quality: NaN, NaN, 0 where it is lost."""


def pack_record(number: int, source_ns: int, points: np.ndarray) -> bytes:
    """The record of a frame with points (markers, 3): x, y [px], quality."""
    return HEADER.pack(number, source_ns, len(points)) + points.astype(POINT).tobytes()


class Tracks(NamedTuple):
    """Records as arrays; a lost marker is NaN, with quality 0."""

    number: np.ndarray
    """(frames,) as the frames were counted; what is missing was dropped."""
    source_ns: np.ndarray
    """(frames,)"""
    xy: np.ndarray
    """(frames, markers, 2) [px]"""
    quality: np.ndarray
    """(frames, markers)"""


def read_records(records: Iterable[bytes]) -> Tracks:
    """Arrays of records. Raises `RigError` for a torn one, or one of another number of markers."""
    heads: list[tuple[int, int]] = []
    points: list[np.ndarray] = []
    for i, record in enumerate(records):
        markers = record[HEADER.size - 1] if len(record) >= HEADER.size else -1
        if len(record) != HEADER.size + 3 * POINT.itemsize * markers:
            raise RigError(f"camera record {i}: is torn ({len(record)} bytes); leave it out")
        if points and points[0].size != 3 * markers:
            raise RigError.value(
                f"camera record {i}", f"{markers} markers", f"{len(points[0])}, as in the first"
            )
        heads.append(HEADER.unpack_from(record)[:2])
        points.append(np.frombuffer(record, POINT, offset=HEADER.size).reshape(-1, 3))
    number, source_ns = np.array(heads, np.int64).reshape(-1, 2).T
    found = np.array(points, float) if points else np.empty((0, 0, 3))
    return Tracks(number, source_ns, found[..., :2], found[..., 2])
