"""The manifold's line: frames out, messages in, by a thread that listens."""

import threading
from collections.abc import Callable
from contextlib import suppress

import serial

from rig.errors import RigError
from rig.manifold.serial_port import PortLost, read_piece
from rig.protocol.messages import FrameDecoder, Message, encode_frame
from rig.recording.clock import host_ns

Sink = Callable[[int, bytes], None]
VENTS = "the manifold vents by itself 0.1 s after the last command"
BAD = 1e-3
"""Share of damaged frames that makes a line a suspect."""


class Connection:
    """`take` gets (host time [ns], message) of all that comes, in the listener's thread.

    `sink` gets (host time [ns], bytes) of all that comes in, there too, `sent` of all that goes
    out, in the thread that writes. `failed` is called once `failure` is set.
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
        self.came = 0
        """Messages."""
        self._port, self._take, self._failed = port, take, failed
        self._sink, self._sent = sink, sent
        self._decoder, self._ends = FrameDecoder(), threading.Event()
        self._thread = threading.Thread(target=self._listen, name="manifold", daemon=True)

    @property
    def damaged(self) -> int:
        """Frames that came in damaged, and were dropped."""
        return self._decoder.damaged

    @property
    def is_bad(self) -> bool:
        """Whether so many came damaged that the line may be to blame for what fails."""
        return self.damaged > BAD * (self.came + self.damaged)

    def start(self) -> None:
        """Listens from now on."""
        self._thread.start()

    def forget(self) -> None:
        """What came so far counts no more."""
        self.came = self._decoder.damaged = 0

    def write(self, message: Message) -> None:
        """Raises `PortLost`."""
        frame = encode_frame(message)
        try:
            self._port.write(frame)
        except (serial.SerialException, OSError) as error:
            raise self._gone(error) from None
        if self._sent is not None:
            self._sent(host_ns(), frame)

    def close(self) -> None:
        """The end of the thread, and the port's."""
        self._ends.set()
        self._thread.join(0.5)
        # A real port may wait long for bytes that nobody takes. One that is gone: termios.error.
        with suppress(Exception):
            self._port.reset_output_buffer()
        self._port.close()

    def _gone(self, error: Exception) -> PortLost:
        failure = PortLost(
            f"{self.name}: the port is gone ({error}); {VENTS}; check its plug and cable"
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
        begun = False
        while not self._ends.is_set():
            try:
                piece = read_piece(self._port)
            except (serial.SerialException, OSError, TypeError) as error:
                # TypeError: pyserial's, where the port is closed meanwhile.
                if not self._ends.is_set():
                    self._gone(error)
                return
            if not piece:
                continue
            now = host_ns()
            if self._sink is not None:
                self._sink(now, piece)
            if not begun:
                # The port was opened within a frame: what is left of that is no damage.
                _, end, piece = piece.partition(b"\0")
                begun = bool(end)
                if not begun:
                    continue
            for message in self._decoder.feed(piece):
                self.came += 1
                self._take(now, message)
