"""Drives the published firmware (of the paper's authors), which runs one test at one frequency."""

import string
import time
from collections.abc import Callable
from typing import NamedTuple

import serial

from rig.errors import RigError
from rig.manifold.serial_port import BAUD, PortLost, read_piece
from rig.protocol.published import Dialogue, Done, Event, Header, LogRow, Question
from rig.recording.clock import Sink

FREQUENCIES = (0.1, 5.0)
"""Lowest and highest allowed frequency [Hz]. The published tests are from 0.25 to 3 Hz."""
QUOTED, MIN_PRINTABLE = 60, 0.9
"""Errors quote at most 60 received characters, and only if at least 90 % are printable."""
MAX_START_WAIT = 5.0
"""Longest wait for the firmware's question, and for the first row after the host's answer [s]."""
MAX_ROW_WAIT = 0.5
"""Longest wait for the next row of a test [s]."""
QUIET = 0.05
"""Time without a byte after which a question or a `done` without a line end is complete [s]."""
CANNOT_STOP = (
    "this firmware has no stop command and no watchdog: a running test drives the valves until "
    "the test ends; close the supply valve by hand"
)


class FrequencyOutcome(NamedTuple):
    """Outcome of a test: the header, and the counts that `Dialogue` defines."""

    header: Header
    rows: int
    damaged: int
    lost: int
    stale: int
    lines: int
    counted: int | None
    """The firmware's count of the sent lines; None if the firmware sent no count."""

    @property
    def findings(self) -> tuple[str, ...]:
        """Problems of the test, one sentence each."""
        found = []
        if self.damaged:
            found.append(f"{self.damaged} damaged lines were dropped")
        if self.lost:
            found.append(f"{self.lost} samples are missing between the received rows")
        if self.stale:
            found.append(f"{self.stale} rows of an earlier test arrived before the header")
        if self.counted not in (None, self.lines):
            found.append(f"the firmware counted {self.counted} lines, {self.lines} arrived")
        return tuple(found)


class PublishedManifold:
    """A manifold with the published firmware, on a port from `serial_port.open_port`.

    The host can send only a frequency. The firmware then commands a sine from 91 to 491 counts (0
    to 370 kPa). The firmware has no stop command and no watchdog: the test runs to the end, even if
    this program, the cable or the computer fails. The only way to stop the test is to close the
    supply valve by hand. The published logs do not show the state of the valves after the test.
    After any error in a test, this class closes the port.

    `ending` is sent after the frequency. `clock` returns the host's time [ns].
    """

    def __init__(
        self,
        port: serial.Serial,
        frequencies: tuple[float, float] = FREQUENCIES,
        ending: bytes = b"\n",
        clock: Callable[[], int] = time.monotonic_ns,
    ):
        self._port, self._frequencies, self._ending, self._clock = port, frequencies, ending, clock
        self._dialogue = Dialogue()
        self._last_byte = clock()

    def run_test(
        self,
        frequency: float,
        on_row: Callable[[int, LogRow], None] = lambda at, row: None,
        sink: Sink = lambda at, piece: None,
    ) -> FrequencyOutcome:
        """Waits for the firmware's question, sends `frequency` [Hz], and reads to the test's end.

        Calls `sink(host time [ns], bytes)` for all bytes of the test, and `on_row(host time [ns],
        LogRow)` after each row. Raises `RigError` for a frequency that is not allowed, a missing
        question, a different frequency in the header, and if rows stop. Raises `PortLost` if the
        port disappears.
        """
        low, high = self._frequencies
        if not low <= frequency <= high:  # also refuses NaN
            raise RigError.value("frequency", f"{frequency:g} Hz", f"{low:g} to {high:g} Hz")
        try:
            self._wait_for_question()
            self._answer(frequency)
            return self._record(frequency, on_row, sink)
        except BaseException:
            self._port.close()
            raise

    def _receive(self, asked: int) -> tuple[int, bytes, list[Event]]:
        """Returns (host time [ns], bytes, events) of one read that begins at `asked` [ns].

        The firmware's silence is measured up to the time before the read. Otherwise, the silence
        would include a pause of this program.
        """
        try:
            piece = read_piece(self._port)
        except OSError as error:
            raise self._gone(error) from None
        now = self._clock()
        if piece:
            self._last_byte = now
            return now, piece, self._dialogue.feed(piece)
        quiet = asked - self._last_byte > QUIET * 1e9
        return now, b"", self._dialogue.quiet() if quiet else []

    def _wait_for_question(self) -> None:
        asked = start = self._clock()
        while asked - start <= MAX_START_WAIT * 1e9:
            asked = self._clock()
            events = self._receive(asked)[2]
            if any(isinstance(event, Question) for event in events):
                return
        if self._dialogue.stale:
            raise RigError(
                f"{self._port.name}: a test is already running ({self._dialogue.stale} rows came); "
                f"wait for its end and try again; {CANNOT_STOP}"
            )
        text = self._dialogue.last_text
        raise RigError(
            f"{self._port.name}: no question for a frequency in {MAX_START_WAIT:g} s; received "
            f"{_quoted(text) if text else 'nothing'}; check that this is the Teensy's port, at "
            f"{BAUD} baud, with the published firmware; reset the board to repeat the question; "
            "for the firmware in rig/firmware, use `slider rig check`"
        )

    def _answer(self, frequency: float) -> None:
        self._dialogue.answered()
        try:
            self._port.write(f"{frequency:.6f}".encode() + self._ending)
        except OSError as error:
            raise self._gone(error) from None

    def _gone(self, error: OSError) -> PortLost:
        """Returns the error for a lost port. pyserial's exceptions are subclasses of `OSError`."""
        return PortLost(
            f"{self._port.name}: the port is gone ({error}); {CANNOT_STOP}, then check the plug "
            "and the cable"
        )

    def _record(
        self, frequency: float, on_row: Callable[[int, LogRow], None], sink: Sink
    ) -> FrequencyOutcome:
        dialogue = self._dialogue
        last, patience = self._clock(), MAX_START_WAIT
        while True:
            asked = self._clock()
            now, piece, events = self._receive(asked)
            done = events[-1] if events and isinstance(events[-1], Done) else None
            ours = piece[: len(piece) - len(dialogue.unparsed)] if done else piece
            if ours:
                sink(now, ours)
            for event in events:
                match event:
                    case Header():
                        self._compare(frequency, event)
                    case LogRow():
                        on_row(now, event)
                        last, patience = now, MAX_ROW_WAIT
            if done:
                return FrequencyOutcome(
                    dialogue.header, dialogue.rows, dialogue.damaged, dialogue.lost, dialogue.stale,
                    dialogue.lines, done.counted,
                )  # fmt: skip
            if asked - last > patience * 1e9:
                where = f"after sample {dialogue.number}" if dialogue.rows else "after the answer"
                text = f"; last text {_quoted(dialogue.last_text)}" if dialogue.last_text else ""
                raise RigError(
                    f"{self._port.name}: no row for {patience:g} s {where}, and no `done`{text}; "
                    f"{CANNOT_STOP}, then check the board's power and cable"
                )

    def _compare(self, frequency: float, header: Header) -> None:
        actual = header.frequency
        if actual is not None and abs(actual - frequency) > 1e-5 * max(1.0, frequency):
            raise RigError(
                f"{self._port.name}: sent {frequency:g} Hz, but the test runs at {actual:g} Hz: "
                f"the firmware misread the frequency; {CANNOT_STOP}"
            )


def _quoted(text: str) -> str:
    """Returns the beginning of `text` in quotation marks, or a remark if `text` is unprintable."""
    begin = text[:QUOTED]
    printable = sum(x in string.printable for x in begin)
    return repr(begin) if printable >= MIN_PRINTABLE * len(begin) else "bytes that are not text"
