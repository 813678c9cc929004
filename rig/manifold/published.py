"""The authors' published firmware on a port: one test at a frequency, its rows as they come."""

import string
import time
from collections.abc import Callable
from typing import NamedTuple

import serial

from rig.errors import RigError
from rig.manifold.serial_port import BAUD, PortLost, read_piece
from rig.protocol.published import Dialogue, Done, Event, Header, LogRow, Question

FREQUENCIES = (0.1, 5.0)
"""Allowed [Hz]; the published sweep is from 0.25 to 3 Hz."""
SHOWN, TEXT = 60, 0.9
"""Characters of what a port said that a message tells, and their share that is text."""
PATIENCE = 5.0
"""For the question, and after the answer for the first row [s]."""
SILENCE = 0.5
"""Without a row in mid-test [s]."""
QUIET = 0.05
"""After so long without a byte [s], a question or a `done` without a line end is complete."""
CANNOT_STOP = (
    "this firmware has no stop command and no watchdog: if it still runs, it drives the valves to "
    "the end of its test; pull the supply valve by hand"
)
Sink = Callable[[int, bytes], None]


class FrequencyOutcome(NamedTuple):
    """What came of a test: its header, and counts of rows as in `Dialogue`."""

    header: Header
    rows: int
    torn: int
    lost: int
    stale: int
    lines: int
    counted: int | None
    """Lines by the firmware's own count, if it gave one."""

    @property
    def findings(self) -> tuple[str, ...]:
        """What is not as it should be, a sentence each."""
        found = []
        if self.torn:
            found.append(f"{self.torn} lines came in damaged and were dropped")
        if self.lost:
            found.append(f"{self.lost} samples are missing between the rows that came")
        if self.stale:
            found.append(f"{self.stale} rows of an earlier test came before the header")
        if self.counted not in (None, self.lines):
            found.append(f"the firmware counts {self.counted} lines, {self.lines} came")
        return tuple(found)


class PublishedManifold:
    """A port on which the published firmware speaks, as `rig.manifold.serial_port.open_port` gives
    it.

    The only thing this firmware can be told is a frequency, and the pressures it then commands are
    its own, 91 to 491 counts (0 to 370 kPa). It has no stop command and no watchdog: once it has
    its frequency it runs the test to the end, whatever happens to this program, the cable or the
    computer, and what its valves do after that is not known from its logs. The hand on the
    supply valve is the only stop. On every error in a test the port is closed.

    `ending` follows the frequency on the wire; `clock` is the host's time [ns].
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

    def run(
        self,
        frequency: float,
        on_row: Callable[[int, LogRow], None] = lambda at, row: None,
        sink: Sink = lambda at, piece: None,
    ) -> FrequencyOutcome:
        """Waits for the question, answers `frequency` [Hz], and stays until the test's end.

        `sink` gets (host time [ns], bytes) of all that comes after the answer up to the test's
        end, `on_row` (host time, `LogRow`) of each row, at the time when its last byte was read.
        Raises `RigError`: a frequency that is not allowed, before anything is on the wire; no
        question; a header with another frequency; no rows; a port that is gone (`PortLost`).
        """
        low, high = self._frequencies
        if not low <= frequency <= high:  # nor is NaN
            raise RigError.value("frequency", f"{frequency:g} Hz", f"{low:g} to {high:g} Hz")
        try:
            self._wait_for_question()
            self._answer(frequency)
            return self._record(frequency, on_row, sink)
        except BaseException:
            self._port.close()
            raise

    def _hear(self, asked: int) -> tuple[int, bytes, list[Event]]:
        """(host time, bytes, events) of one read that begins at `asked`.

        Waiting is measured up to `asked`, before the read: else a program that was not run for a
        while would take that for the firmware's silence.
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
        asked = begun = self._clock()
        while asked - begun <= PATIENCE * 1e9:
            asked = self._clock()
            events = self._hear(asked)[2]
            if any(isinstance(event, Question) for event in events):
                return
        if self._dialogue.stale:
            raise RigError(
                f"{self._port.name}: a test is running, {self._dialogue.stale} rows came unasked; "
                f"wait for its end and try again; {CANNOT_STOP}"
            )
        said = self._dialogue.said
        raise RigError(
            f"{self._port.name}: no question for a frequency in {PATIENCE:g} s, "
            f"{f'but {_told(said)}' if said else 'and nothing else'}; is this the Teensy's port, "
            f"at {BAUD} baud, with the published firmware? Reset the board: it asks at its start; "
            "one of the framed protocol is for `slider rig check`"
        )

    def _answer(self, frequency: float) -> None:
        self._dialogue.answered()
        try:
            self._port.write(f"{frequency:.6f}".encode() + self._ending)
        except OSError as error:
            raise self._gone(error) from None

    def _gone(self, error: OSError) -> PortLost:
        """What pyserial raises is an `OSError` too."""
        return PortLost(
            f"{self._port.name}: the port is gone ({error}); {CANNOT_STOP}, then check plug and "
            "cable"
        )

    def _record(
        self, frequency: float, on_row: Callable[[int, LogRow], None], sink: Sink
    ) -> FrequencyOutcome:
        dialogue = self._dialogue
        last, patience = self._clock(), PATIENCE
        while True:
            asked = self._clock()
            now, piece, events = self._hear(asked)
            done = events[-1] if events and isinstance(events[-1], Done) else None
            ours = piece[: len(piece) - len(dialogue.rest)] if done else piece
            if ours:
                sink(now, ours)
            for event in events:
                match event:
                    case Header():
                        self._compare(frequency, event)
                    case LogRow():
                        on_row(now, event)
                        last, patience = now, SILENCE
            if done:
                return FrequencyOutcome(
                    dialogue.header, dialogue.rows, dialogue.torn, dialogue.lost, dialogue.stale,
                    dialogue.lines, done.counted,
                )  # fmt: skip
            if asked - last > patience * 1e9:
                where = f"after sample {dialogue.number}" if dialogue.rows else "after the answer"
                said = f"; it said {_told(dialogue.said)}" if dialogue.said else ""
                raise RigError(
                    f"{self._port.name}: no row for {patience:g} s {where}, and no `done`{said}; "
                    f"{CANNOT_STOP}, then look at the board's power and cable"
                )

    def _compare(self, frequency: float, header: Header) -> None:
        heard = header.frequency
        if heard is not None and abs(heard - frequency) > 1e-5 * max(1.0, frequency):
            raise RigError(
                f"{self._port.name}: asked for {frequency:g} Hz, the test runs at {heard:g} Hz: "
                f"the answer was not understood; {CANNOT_STOP}"
            )


def _told(said: str) -> str:
    """How a message tells what a port said: its beginning, or that it is no text."""
    begin = said[:SHOWN]
    readable = sum(x in string.printable for x in begin)
    return repr(begin) if readable >= TEXT * len(begin) else "bytes that are no text"
