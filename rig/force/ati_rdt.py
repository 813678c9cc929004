"""RDT, the stream of an ATI Net F/T box, as data: requests, records, and tables with their gaps.

A request is 8 bytes, a record 36, big endian, one a UDP datagram (ATI manual 9620-05-NET FT).
UDP loses, doubles and reorders; records are numbered, so that those missing are known exactly.
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
"""Samples a second that a box takes, whatever part of them it sends; `ft_seq` counts them."""
ERROR, SATURATED, LATCHED = 1 << 31, 1 << 17, 1 << 16
"""Bits of the status: any error; transducer saturated; a threshold was passed (no error)."""
STUCK = 0.1
"""Six axes that keep their counts for so long [s] are no measurement: a live one has noise."""

RECORD = struct.Struct(">III6i")
_FIELDS = np.dtype([("rdt", ">u4"), ("ft", ">u4"), ("status", ">u4"), ("counts", ">i4", 6)])


def request_bytes(command: int, count: int = 0) -> bytes:
    """The bytes of a command; a `count` of 0 streams until stopped."""
    return struct.pack(">HHI", 0x1234, command, count)


def check_size(datagram: bytes, where: str) -> None:
    """Raise `RigError` for what is no record."""
    if len(datagram) != RECORD.size:
        raise RigError.value(
            where,
            f"a datagram of {len(datagram)} bytes",
            f"records of {RECORD.size}",
            "see that this is a Net F/T box, and its RDT port",
        )


def has_box_error(status):
    """True where a status, a number or an array, tells of more than saturation or a threshold."""
    return (status & ~(ERROR | SATURATED | LATCHED) != 0) | (status == ERROR)


def is_invalid(status):
    """True where a record is no measurement: saturated, or the box tells an error."""
    return (status & SATURATED != 0) | has_box_error(status)


def status_text(status: int) -> str:
    """What a status says; empty if it says no error."""
    told = ["saturated"] if status & SATURATED else []
    if has_box_error(status):
        told.append("an error of the box, see System Status Code in its manual")
    return f"status {status:#010x}: {', '.join(told)}" if told else ""


class BoxTime:
    """The box's own time, record by record: its samples are even, their arrivals are not."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._counts = 0

    def seconds(self, ft_seq: int) -> float | None:
        """Since the first record [s]; None for one that comes again, or after a later one."""
        if self._last is not None:
            step = (ft_seq - self._last + 2**31) % 2**32 - 2**31
            if step <= 0:
                return None
            self._counts += step
        self._last = ft_seq
        return self._counts / INTERNAL_RATE


class StreamTally:
    """Counts of a stream while it runs, record by record."""

    def __init__(self) -> None:
        self.received = self.late = self.duplicates = self.saturated = 0
        self.fault = 0
        """The last status that told of an error."""
        self.missing: set[int] = set()
        """Numbers passed over that have not come yet."""
        self._highest = 0

    def count(self, rdt_seq: int, status: int) -> None:
        """Take one record. A box numbers the records of a stream from 1."""
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
    """A stream in the order of its numbers, (n,) from the first to the last that came.

    | field | meaning |
    |---|---|
    | `seq` | number, counted on where the box's 32 bits roll over |
    | `present` | False where the record never came; the fields below are 0 there |
    | `host_ns` | arrival, host's monotonic clock [ns] |
    | `ft_seq`, `status` | the box's count of its own samples, and its status |
    | `counts` | (n, 6) Fx, Fy, Fz, Tx, Ty, Tz |
    | `late`, `duplicates` | how many came after a higher number, or again |
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
        """Numbers of the records that never came."""
        return self.seq[~self.present]

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """First and last number of each run of missing records."""
        runs = np.split(self.missing, np.flatnonzero(np.diff(self.missing) > 1) + 1)
        return [(int(run[0]), int(run[-1])) for run in runs if len(run)]

    @property
    def rate(self) -> float:
        """Records a second by the box's own clock, from `ft_seq`."""
        first, last = np.flatnonzero(self.present)[[0, -1]]
        samples = int(self.ft_seq[last] - self.ft_seq[first]) % 2**32
        if not samples:
            raise RigError.value(
                "force sensor's record",
                f"ft_seq {self.ft_seq[last]} throughout",
                "a count that rises",
            )
        return INTERNAL_RATE * int(last - first) / samples

    def times(self) -> np.ndarray:
        """(n,) when each was sampled, host's monotonic clock [ns], also of those missing."""
        if len(self.seq) == 1:
            return self.host_ns
        at = self.present
        return host_sample_times(self.seq[at], self.host_ns[at], self.rate, self.seq)

    @property
    def stuck(self) -> np.ndarray:
        """(n,) True in runs of equal counts that last `STUCK` or longer."""
        rows = np.flatnonzero(self.present)
        new = np.any(np.diff(self.counts[rows], axis=0) != 0, axis=1)
        run = np.concatenate([[0], np.cumsum(new)])
        found = np.zeros(len(self.seq), bool)
        if len(rows) > 1:
            found[rows] = np.bincount(run)[run] >= STUCK * self.rate
        return found

    @property
    def doubtful(self) -> np.ndarray:
        """(n,) True where saturated, stuck, or the box told an error."""
        return self.stuck | is_invalid(self.status)

    def findings(self) -> tuple[str, ...]:
        """What a user should know of, a sentence each."""
        told = []
        if len(self.missing):
            told.append(f"{len(self.missing)} of {len(self.seq)} records missing")
        if self.late or self.duplicates:
            told.append(f"{self.late} records came late and {self.duplicates} twice; put in order")
        if stuck := int(self.stuck.sum()):
            told.append(f"{stuck} records repeat the same counts for {STUCK:g} s or longer: stuck")
        for status in np.unique(self.status):
            if text := status_text(int(status)):
                told.append(f"{int((self.status == status).sum())} records with {text}")
        return tuple(told)


def record_table(host_ns: Sequence[int] | np.ndarray, datagrams: Sequence[bytes]) -> Records:
    """The records of one stream, from arrival times [ns] and datagrams in order of arrival.

    What was lost before the first number or after the last cannot be seen. Raises `RigError` if
    there is none, one has another size, or a number comes again with other content (a new stream).
    """
    if not datagrams:
        raise RigError("force sensor: no records; nothing came while it was recorded")
    for i, datagram in enumerate(datagrams):
        check_size(datagram, f"force sensor's datagram {i}")
    joined = b"".join(datagrams)
    raw = np.frombuffer(joined, _FIELDS)
    content = np.frombuffer(joined, np.uint8).reshape(len(raw), -1)
    rdt = raw["rdt"].astype(np.uint32)
    number = rdt[0] + (rdt - rdt[0]).astype(np.int32).astype(np.int64)  # over the roll to 0
    unique, first, back = np.unique(number, return_index=True, return_inverse=True)
    other = np.flatnonzero((content != content[first[back]]).any(axis=1))
    if len(other) or unique[-1] - unique[0] > 100 * len(raw) + 10**6:
        at = other[0] if len(other) else int(np.argmax(np.abs(np.diff(number)))) + 1
        raise RigError.value(
            f"force sensor's datagram {at}",
            f"number {number[at]}, as if a new stream began",
            "one stream",
            "read those before it and those from it on apart",
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
