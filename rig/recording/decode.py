"""The manifold's stream as arrays: what it read, and what was lost or damaged on the way."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from rig.errors import RigError
from rig.protocol.messages import CHANNELS, Arm, Event, Follows, FrameDecoder, Reading, SetPressures
from rig.recording.reader import Recording


class DecodedReadings(NamedTuple):
    """(n,) arrays by sequence number, n readings that came."""

    seq: np.ndarray
    """Counted on where the manifold's 32 bits roll over."""
    host_s: np.ndarray
    """Arrival, host's monotonic clock [s]."""
    device_s: np.ndarray
    """When they were due, the manifold's clock [s]."""
    state: np.ndarray
    command: np.ndarray
    """Number of the set pressures that were followed."""
    channels: np.ndarray
    """(n, 8) as in `CHANNELS`."""
    lost: int
    duplicated: int
    damaged: int
    events: list[tuple[float, Event]]
    """With the host's time of arrival [s]."""
    follows: list[Follows]
    """The set pressures that were followed, one after the other."""

    def pressures(self) -> tuple[np.ndarray, np.ndarray]:
        """Signed pressures (n,) of the front and the rear segment [Pa]: left less right."""
        p = self.channels
        return p[:, 0] - p[:, 1], p[:, 2] - p[:, 3]


def decode_readings(pieces: Iterable[tuple[int, bytes]]) -> DecodedReadings:
    """From (host time [ns], bytes) as they came. What is before the first end of a frame is not
    counted as damage, for a recording may begin within one."""
    decoder, begun = FrameDecoder(), False
    found: list[tuple[float, Reading]] = []
    events: list[tuple[float, Event]] = []
    follows: list[Follows] = []
    for host_ns, piece in pieces:
        if not begun:
            _, end, piece = piece.partition(b"\0")
            begun = bool(end)
        if not begun:
            continue
        for message in decoder.feed(piece):
            if isinstance(message, Reading):
                found.append((host_ns * 1e-9, message))
            elif isinstance(message, Event):
                events.append((host_ns * 1e-9, message))
            elif isinstance(message, Follows):
                follows.append(message)
    number, last = 0, None
    kept: dict[int, tuple[float, Reading]] = {}
    for host_s, reading in found:
        if last is not None:
            step = (reading.seq - last) % 2**32
            number += step if step < 2**31 else step - 2**32
        last = reading.seq
        kept.setdefault(number, (host_s, reading))
    order = sorted(kept)
    rows = [kept[i] for i in order]
    seq = np.array(order, np.int64)
    return DecodedReadings(
        seq,
        np.array([host_s for host_s, _ in rows]),
        np.array([1e-6 * r.device_us for _, r in rows]),
        np.array([r.state for _, r in rows], np.int64),
        np.array([r.command for _, r in rows], np.int64),
        np.array([r.channels for _, r in rows], float).reshape(len(rows), len(CHANNELS)),
        lost=int(seq[-1] - seq[0] + 1 - len(seq)) if len(seq) else 0,
        duplicated=len(found) - len(rows),
        damaged=decoder.damaged,
        events=events,
        follows=follows,
    )


class DriveSpan(NamedTuple):
    """Of a drive that was recorded."""

    begun_ns: int
    """Host time of its first command [ns]."""
    seconds: float
    """From then to the last that came of the manifold [s]."""


def drive_span(recording: Recording) -> DriveSpan:
    """Of the drive in a recording, by its commands. Raises `RigError` where it has not begun."""
    decoder, armed = FrameDecoder(), False
    went, came = recording.streams["commands"], recording.streams["manifold"]
    for host_ns, piece in zip(went.host_ns.tolist(), went.pieces(), strict=True):
        for message in decoder.feed(piece):
            armed = armed or isinstance(message, Arm)
            if armed and isinstance(message, SetPressures):
                last = int(came.host_ns[-1]) if len(came.host_ns) else host_ns
                return DriveSpan(host_ns, max(1e-9 * (last - host_ns), 0.0))
    raise RigError("recording: its drive had not begun when the run ended; record it again")
