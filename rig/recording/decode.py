"""Decodes the manifold's recorded streams: readings, number of losses, and time of the drive."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from rig.errors import RigError
from rig.protocol.messages import Arm, Follows, FrameDecoder, Reading, SetPressures
from rig.recording.clock import unwrap_counter
from rig.recording.reader import Recording


class DecodedReadings(NamedTuple):
    """The n received readings without duplicates, by sequence number, as arrays of shape (n,)."""

    seq: np.ndarray
    """Sequence number, continued if the manifold's 32-bit counter restarts from 0."""
    host_s: np.ndarray
    """Arrival time on the host's monotonic clock [s]."""
    device_s: np.ndarray
    """Time at which the reading was due, on the manifold's clock [s]."""
    state: np.ndarray
    command: np.ndarray
    """Number `seq` of the last `SetPressures` command that the manifold accepted."""
    channels: np.ndarray
    """(n, channels) in the order and units of `channel_names`."""
    lost: int
    duplicated: int
    damaged: int
    follows: list[Follows]
    """Changes of the set pressures that the manifold followed, in order of arrival."""


def decode_readings(pieces: Iterable[tuple[int, bytes]]) -> DecodedReadings:
    """Returns the readings in a stream of (host time [ns], bytes).

    A first frame that is incomplete does not count as damaged, because a recording may start within
    a frame.
    """
    decoder = FrameDecoder(in_step=False)
    received: list[tuple[float, Reading]] = []
    follows: list[Follows] = []
    for host_ns, piece in pieces:
        for message in decoder.feed(piece):
            if isinstance(message, Reading):
                received.append((host_ns * 1e-9, message))
            elif isinstance(message, Follows):
                follows.append(message)
    numbers = unwrap_counter(np.array([reading.seq for _, reading in received]), 2**32)
    kept: dict[int, tuple[float, Reading]] = {}
    for number, row in zip((numbers - numbers[:1]).tolist(), received, strict=True):
        kept.setdefault(number, row)
    order = sorted(kept)
    rows = [kept[i] for i in order]
    seq = np.array(order, np.int64)
    return DecodedReadings(
        seq,
        np.array([host_s for host_s, _ in rows]),
        np.array([1e-6 * r.device_us for _, r in rows]),
        np.array([r.state for _, r in rows], np.int64),
        np.array([r.command for _, r in rows], np.int64),
        np.array([r.channels for _, r in rows], float),
        lost=int(seq[-1] - seq[0] + 1 - len(seq)) if len(seq) else 0,
        duplicated=len(received) - len(rows),
        damaged=decoder.damaged,
        follows=follows,
    )


class DriveSpan(NamedTuple):
    """Start and duration of the drive in a recording."""

    begun_ns: int
    """Host time of the drive's first command [ns]."""
    seconds: float
    """Time from the first command to the manifold's last bytes [s]."""


def drive_span(recording: Recording) -> DriveSpan:
    """Returns start and duration of the drive of an interrupted run, from its recorded commands.

    Raises `RigError` if the drive had not begun.
    """
    decoder, armed = FrameDecoder(), False
    sent, received = recording.streams["commands"], recording.streams["manifold"]
    for host_ns, piece in zip(sent.host_ns.tolist(), sent.pieces(), strict=True):
        for message in decoder.feed(piece):
            armed = armed or isinstance(message, Arm)
            if armed and isinstance(message, SetPressures):
                last = int(received.host_ns[-1]) if len(received.host_ns) else host_ns
                return DriveSpan(host_ns, max(1e-9 * (last - host_ns), 0.0))
    raise RigError("recording: the run ended before the drive began; record the trial again")
