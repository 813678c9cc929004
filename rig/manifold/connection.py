"""Serial connection to the manifold: sends frames, and receives messages in a thread."""

import threading
from collections.abc import Callable
from contextlib import suppress

import serial

from rig.errors import RigError
from rig.manifold.serial_port import PortLost, read_piece
from rig.protocol.messages import FrameDecoder, Message, encode_frame
from rig.recording.clock import Sink, host_ns

VENTS = "the manifold vents by itself 0.1 s after the last command"
MAX_DAMAGED = 1e-3
"""Fraction of damaged frames above which errors mention the cable as a possible cause."""


class Connection:
    """A serial port with a thread that receives messages.

    The thread calls `take(host time [ns], message)` for each message and `sink(host time [ns],
    bytes)` for each read. `write` calls `sent(host time [ns], bytes)` for each frame. After an
    error, `failed()` is called.
    """

    def __init__(
        self,
        port: serial.Serial,
        take: Callable[[int, Message], None],
        failed: Callable[[], None],
        sink: Sink | None = None,
        sent: Sink | None = None,
    ):
        self.name: str = port.name
        self.failure: RigError | None = None
        self.received = 0
        """Number of received messages."""
        self._port, self._take, self._failed = port, take, failed
        self._sink, self._sent = sink, sent
        self._decoder, self._ends = FrameDecoder(in_step=False), threading.Event()
        self._thread = threading.Thread(target=self._listen, name="manifold", daemon=True)

    @property
    def damaged(self) -> int:
        """Number of damaged frames, which are dropped."""
        return self._decoder.damaged

    @property
    def is_bad(self) -> bool:
        """Whether the fraction of damaged frames exceeds `MAX_DAMAGED`."""
        return self.damaged > MAX_DAMAGED * (self.received + self.damaged)

    def start(self) -> None:
        """Starts the receiving thread."""
        self._thread.start()

    def reset_counts(self) -> None:
        """Sets the counts of received and damaged frames to 0."""
        self.received = self._decoder.damaged = 0

    def write(self, message: Message) -> None:
        """Sends `message`. Raises `PortLost` if the port has disappeared."""
        frame = encode_frame(message)
        try:
            self._port.write(frame)
        except (serial.SerialException, OSError) as error:
            raise self._gone(error) from None
        if self._sent is not None:
            self._sent(host_ns(), frame)

    def close(self) -> None:
        """Ends the thread and closes the port."""
        self._ends.set()
        self._thread.join(0.5)
        # Discards unsent bytes: `close` could wait long for them. A lost port raises termios.error.
        with suppress(Exception):
            self._port.reset_output_buffer()
        self._port.close()

    def _gone(self, error: Exception) -> PortLost:
        failure = PortLost(
            f"{self.name}: the port is gone ({error}); {VENTS}; check the plug and the cable"
        )
        self._fail(failure)
        return failure

    def _fail(self, failure: RigError) -> None:
        self.failure = failure
        self._failed()

    def _listen(self) -> None:
        try:
            self._pieces()
        except Exception as error:
            self._fail(RigError(f"{self.name}: stopped reading: {error!r}"))

    def _pieces(self) -> None:
        while not self._ends.is_set():
            try:
                piece = read_piece(self._port)
            except (serial.SerialException, OSError, TypeError) as error:
                # pyserial raises TypeError if another thread has closed the port.
                if not self._ends.is_set():
                    self._gone(error)
                return
            if not piece:
                continue
            now = host_ns()
            if self._sink is not None:
                self._sink(now, piece)
            for message in self._decoder.feed(piece):
                self.received += 1
                self._take(now, message)
