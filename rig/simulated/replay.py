"""What a recorded manifold said, said again at its own pace."""

from rig.recording.reader import RecordedStream


class Replay:
    """A device that sends a recording's stream, and hears nothing. Silent at its end."""

    def __init__(self, stream: RecordedStream, speed: float = 1.0):
        start = int(stream.host_ns[0]) if len(stream.host_ns) else 0
        self._due = [(int(t) - start) / (1000 * speed) for t in stream.host_ns]
        self._pieces, self._next = stream.pieces(), 0

    @property
    def ended(self) -> bool:
        """Whether all is said."""
        return self._next == len(self._pieces)

    def feed(self, piece: bytes, now_us: int) -> bytes:
        """Nothing is answered."""
        return b""

    def tick(self, now_us: int) -> bytes:
        """What was said up to then."""
        first = self._next
        while not self.ended and self._due[self._next] <= now_us:
            self._next += 1
        return b"".join(self._pieces[first : self._next])
