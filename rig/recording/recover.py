"""What a recording tells of its trial where nothing else does: the run was killed in it."""

from typing import NamedTuple

from rig.errors import RigError
from rig.protocol.frames import Decoder
from rig.protocol.messages import Arm, SetPressures
from rig.recording.reader import Recording


class Extent(NamedTuple):
    """Of a drive that was recorded."""

    begun_ns: int
    """Host time of its first command [ns]."""
    seconds: float
    """From then to the last that came of the manifold [s]."""


def extent(recording: Recording) -> Extent:
    """Of the drive in a recording, by its commands. Raises `RigError` where it has not begun."""
    decoder, armed = Decoder(), False
    went, came = recording.streams["commands"], recording.streams["manifold"]
    for host_ns, piece in zip(went.host_ns.tolist(), went.pieces(), strict=True):
        for message in decoder.feed(piece):
            armed = armed or isinstance(message, Arm)
            if armed and isinstance(message, SetPressures):
                last = int(came.host_ns[-1]) if len(came.host_ns) else host_ns
                return Extent(host_ns, max(1e-9 * (last - host_ns), 0.0))
    raise RigError("recording: its drive had not begun when the run ended; record it again")
