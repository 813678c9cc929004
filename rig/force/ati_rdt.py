"""Defines RDT, the stream format of an ATI Net F/T box: requests, records, tables of records.

A UDP datagram contains one request of 8 bytes or one record of 36 bytes, big endian (ATI manual
9620-05-NET FT). UDP may lose, duplicate and reorder records. The records are therefore numbered.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.errors import RigError
from rig.recording.clock import host_sample_times

PORT = 49152
STOP, START, BIAS = 0, 2, 0x42
INTERNAL_RATE = 7000.0
"""Rate [1/s] at which the box samples. `ft_seq` counts all samples; the box sends only some."""
ERROR, SATURATED, LATCHED = 1 << 31, 1 << 17, 1 << 16
"""Bits of the status: any error; saturated transducer; load above a threshold (not an error)."""
STUCK = 0.1
"""A sensor is stuck if all six counts are constant for this time [s]. Noise changes the counts of
a working sensor more often."""

RECORD = struct.Struct(">III6i")
_FIELDS = np.dtype([("rdt", ">u4"), ("ft", ">u4"), ("status", ">u4"), ("counts", ">i4", 6)])


def request_bytes(command: int, count: int = 0) -> bytes:
    """Returns the bytes of a command. With a `count` of 0, the box streams until it is stopped."""
    return struct.pack(">HHI", 0x1234, command, count)


def check_size(datagram: bytes, where: str) -> None:
    """Raises `RigError` if a datagram does not have the size of a record."""
    if len(datagram) != RECORD.size:
        raise RigError.value(
            where,
            f"a datagram of {len(datagram)} bytes",
            f"records of {RECORD.size}",
            "check that this is the RDT port of a Net F/T box",
        )


def has_box_error(status):
    """Returns whether a status (number or array) shows an error other than saturation."""
    return (status & ~(ERROR | SATURATED | LATCHED) != 0) | (status == ERROR)


def is_invalid(status):
    """Returns whether a status (number or array) shows saturation or another error."""
    return (status & SATURATED != 0) | has_box_error(status)


def status_text(status: int) -> str:
    """Returns a description of the errors in a status; empty without an error."""
    parts = ["saturated"] if status & SATURATED else []
    if has_box_error(status):
        parts.append("an error of the box, see System Status Code in its manual")
    return f"status {status:#010x}: {', '.join(parts)}" if parts else ""


class BoxTime:
    """Computes the records' times by the box's clock, because records arrive irregularly."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._counts = 0

    def seconds(self, ft_seq: int) -> float | None:
        """Returns the time since the first record [s]; None for a repeated or late record."""
        if self._last is not None:
            step = (ft_seq - self._last + 2**31) % 2**32 - 2**31
            if step <= 0:
                return None
            self._counts += step
        self._last = ft_seq
        return self._counts / INTERNAL_RATE


class StreamTally:
    """Counts the records of a running stream."""

    def __init__(self) -> None:
        self.received = self.late = self.duplicates = self.saturated = 0
        self.fault = 0
        """The last status with an error."""
        self.missing: set[int] = set()
        """Numbers of the records that have not arrived although a later record has arrived."""
        self._highest = 0

    def count(self, rdt_seq: int, status: int) -> None:
        """Counts one record. A box numbers the records of a stream from 1."""
        self.received += 1
        self.saturated += bool(status & SATURATED)
        if has_box_error(status):
            self.fault = status
        step = (rdt_seq - self._highest + 2**31) % 2**32 - 2**31
        number = self._highest + step
        if step > 0:
            self.missing.update(range(self._highest + 1, number))
            self._highest = number
        elif number in self.missing:
            self.missing.remove(number)
            self.late += 1
        else:
            self.duplicates += 1


@dataclass(frozen=True)
class Records:
    """The records of a stream (n,), ordered by number from the first to the last received record.

    | field | meaning |
    |---|---|
    | `seq` | number of the record, continued if the box's 32-bit counter restarts from 0 |
    | `present` | False for a missing record; the fields below are then 0 |
    | `host_ns` | time of arrival on the host's monotonic clock [ns] |
    | `ft_seq`, `status` | the box's count of its own samples, and its status |
    | `counts` | (n, 6) Fx, Fy, Fz, Tx, Ty, Tz |
    | `late`, `duplicates` | number of records that arrived late, and of repeated records |
    """

    seq: np.ndarray
    present: np.ndarray
    host_ns: np.ndarray
    ft_seq: np.ndarray
    status: np.ndarray
    counts: np.ndarray
    late: int
    duplicates: int

    @property
    def missing(self) -> np.ndarray:
        """Numbers of the missing records."""
        return self.seq[~self.present]

    @property
    def rate(self) -> float:
        """Rate of the records by the box's own clock [1/s], from `ft_seq`."""
        first, last = np.flatnonzero(self.present)[[0, -1]]
        samples = int(self.ft_seq[last] - self.ft_seq[first]) % 2**32
        if not samples:
            raise RigError.value(
                "force sensor's record", f"constant ft_seq {self.ft_seq[last]}", "a rising count"
            )
        return INTERNAL_RATE * int(last - first) / samples

    def times(self) -> np.ndarray:
        """Returns the sampling times (n,) on the host's clock [ns], also of missing records."""
        if len(self.seq) == 1:
            return self.host_ns
        at = self.present
        return host_sample_times(self.seq[at], self.host_ns[at], self.rate, self.seq)

    @property
    def stuck(self) -> np.ndarray:
        """(n,) True where the counts are constant for the time `STUCK` or longer."""
        rows = np.flatnonzero(self.present)
        new = np.any(np.diff(self.counts[rows], axis=0) != 0, axis=1)
        run = np.concatenate([[0], np.cumsum(new)])
        stuck = np.zeros(len(self.seq), bool)
        if len(rows) > 1:
            stuck[rows] = np.bincount(run)[run] >= STUCK * self.rate
        return stuck

    @property
    def doubtful(self) -> np.ndarray:
        """(n,) True where the sensor was saturated or stuck, or the box reported an error."""
        return self.stuck | is_invalid(self.status)

    def findings(self) -> tuple[str, ...]:
        """Returns the problems for the user, one sentence each."""
        found = []
        if len(self.missing):
            found.append(f"{len(self.missing)} of {len(self.seq)} records missing")
        if self.late or self.duplicates:
            found.append(
                f"{self.late} late records were sorted in; {self.duplicates} repeats were dropped"
            )
        if stuck := int(self.stuck.sum()):
            found.append(f"{stuck} records of a stuck sensor: constant for {STUCK:g} s or longer")
        for status in np.unique(self.status):
            if text := status_text(int(status)):
                found.append(f"{int((self.status == status).sum())} records with {text}")
        return tuple(found)


def record_table(host_ns: Sequence[int] | np.ndarray, datagrams: Sequence[bytes]) -> Records:
    """Returns the records of one stream, from arrival times [ns] and datagrams in order of arrival.

    Losses before the first or after the last record cannot be detected. Raises `RigError` for an
    empty stream, a record of wrong size, or two different records with one number (two streams).
    """
    if not datagrams:
        raise RigError("force sensor: no records arrived in the recording; run `slider rig check`")
    for i, datagram in enumerate(datagrams):
        check_size(datagram, f"force sensor's datagram {i}")
    joined = b"".join(datagrams)
    raw = np.frombuffer(joined, _FIELDS)
    content = np.frombuffer(joined, np.uint8).reshape(len(raw), -1)
    rdt = raw["rdt"].astype(np.uint32)
    number = rdt[0] + (rdt - rdt[0]).astype(np.int32).astype(
        np.int64
    )  # valid across the 32-bit overflow
    unique, first, back = np.unique(number, return_index=True, return_inverse=True)
    other = np.flatnonzero((content != content[first[back]]).any(axis=1))
    if len(other) or unique[-1] - unique[0] > 100 * len(raw) + 10**6:
        at = other[0] if len(other) else int(np.argmax(np.abs(np.diff(number)))) + 1
        raise RigError.value(
            f"force sensor's datagram {at}",
            f"number {number[at]}, as if a new stream began",
            "one stream",
            "read the two streams separately",
        )
    row = unique - unique[0]
    size = int(row[-1]) + 1

    def column(values: np.ndarray) -> np.ndarray:
        filled = np.zeros((size, *values.shape[1:]), np.int64)
        filled[row] = values[first]
        return filled

    is_first = np.zeros(len(raw), bool)
    is_first[first] = True
    return Records(
        seq=unique[0] + np.arange(size),
        present=column(np.ones(len(raw))) > 0,
        host_ns=column(np.asarray(host_ns, np.int64)),
        ft_seq=column(raw["ft"]),
        status=column(raw["status"]),
        counts=column(raw["counts"]),
        late=int((is_first & (np.maximum.accumulate(number) > number)).sum()),
        duplicates=len(raw) - len(unique),
    )
