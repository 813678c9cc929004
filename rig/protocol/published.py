"""Parses the text that the published firmware (of the paper's authors) sends.

The firmware asks for a frequency and waits. After the answer, the firmware runs one test. It sends
a header with one `name value` pair per line, a line of column names, and one row per sample. The
last line is `done`, which may contain the number of preceding lines. Lines end in CR, LF or CRLF.
Source: the public repository bvanstratum/SoftSnakePressureControl and its frequency tests of
2022-12-21. In the logs of these tests, `done` has no count and no line end, a row may precede the
header, and the text of the question is missing.
"""

import re
from enum import Enum
from typing import NamedTuple

COLUMNS = "N_sample,fluidInVoltage,fluidOutVoltage,pressureCommanded,pressureError,pressure"
PSI_PER_COUNT = 0.13529
PSI_AT_ZERO = -12.4282
PA_PER_PSI = 6894.757
LONGEST_LINE = 512
"""Largest number of bytes without a line end. A longer sequence counts as one damaged line."""
MAX_UNCONFIRMED_GAP = 50
"""Largest step of the sample number that is accepted without confirmation by the next row."""

_NUMBER = r"(\d+(?:\.\d*)?)"
_HEADER = {
    "frequency": (re.compile(rf"frequency:?\s+{_NUMBER}\s*Hz", re.I), 1.0),
    "start": (re.compile(rf"start time:?\s+{_NUMBER}\s*ms", re.I), 1e-3),
    "stop": (re.compile(rf"stop time:?\s+{_NUMBER}\s*ms", re.I), 1e-3),
    "period": (re.compile(rf"sample p(?:r|erio)d:?\s+{_NUMBER}\s*ms", re.I), 1e-3),
    "cycles": (re.compile(rf"number cy(?:lc|cl)es:?\s+{_NUMBER}", re.I), 1.0),
}
_ROW = re.compile(r"(\d{1,9}),(\d{1,3}),(\d{1,3}),(-?\d{1,5}\.\d\d),(-?\d{1,5}\.\d\d),(\d{1,4})")
_DONE = re.compile(rb"\s*done[ \t]*(\d*)[ \t]*", re.I)
# A line end or the next question follows `done`. After a final CR, an LF may still arrive.
_DONE_ENDED = re.compile(_DONE.pattern + rb"(?:\r\n|\n|\r(?=[^\n])|(?=[^\d\s]))", re.I)
_QUESTION = re.compile(r"freq|hz", re.I)
_END = re.compile(rb"\r\n|\r|\n")


def counts_to_pascal(counts: float) -> float:
    """Returns the gauge pressure [Pa] of ADC `counts`."""
    return PA_PER_PSI * (PSI_PER_COUNT * counts + PSI_AT_ZERO)


class Question(NamedTuple):
    """The firmware's question for a frequency. The firmware then waits for the answer."""

    text: str


class Header(NamedTuple):
    """Header of a test: frequency [Hz], times [s]. None replaces a missing or damaged value."""

    frequency: float | None = None
    start: float | None = None
    stop: float | None = None
    period: float | None = None
    cycles: float | None = None


class LogRow(NamedTuple):
    """A sample: valve duties `fill` and `vent` (0 to 255), pressures and `error` [ADC counts]."""

    number: int
    fill: int
    vent: int
    command: float
    error: float
    pressure: int

    @property
    def command_Pa(self) -> float:
        """Commanded gauge pressure [Pa]."""
        return counts_to_pascal(self.command)

    @property
    def pressure_Pa(self) -> float:
        """Measured gauge pressure [Pa]."""
        return counts_to_pascal(self.pressure)


class Done(NamedTuple):
    """End of the test. `counted` is the firmware's count of lines, or None if it sends no count."""

    counted: int | None


Event = Question | Header | LogRow | Done


class DialogueStage(Enum):
    """Stage of the dialogue with the firmware."""

    IDLE = "no test runs"
    HEADER = "the frequency was sent; rows before the header belong to an earlier test"
    ROWS = "the test runs"


class Dialogue:
    """Parses the firmware's bytes in pieces of any size. All counts are for the current test."""

    def __init__(self) -> None:
        self.unparsed = b""
        """Bytes of an unfinished line, and bytes that were received after a test's end."""
        self.last_text = ""
        """Last received line that was not a row."""
        self._question = ""
        self._begin(DialogueStage.IDLE)

    def _begin(self, stage: DialogueStage) -> None:
        self.stage, self.header = stage, Header()
        self.lines = 0
        """Number of the test's lines, without blank lines and `done`."""
        self.rows = self.damaged = self.stale = self.lost = 0
        """Number of accepted rows, of damaged lines, of an earlier test's rows, of lost samples."""
        self.number = 0
        """Sample number of the last accepted row."""
        self._candidate = 0

    def answered(self) -> None:
        """Starts a test. Call this method when the frequency is sent."""
        self._begin(DialogueStage.HEADER)
        self.unparsed, self.last_text, self._question = b"", "", ""

    def feed(self, piece: bytes) -> list[Event]:
        """Returns the events that `piece` completes. Bytes after a test's end are kept unparsed."""
        self.unparsed += piece
        events: list[Event] = []
        at = 0
        for end in _END.finditer(self.unparsed):
            if self.stage is not DialogueStage.IDLE and _DONE.match(self.unparsed, at):
                break
            events += self._line(self.unparsed[at : end.start()])
            at = end.end()
        self.unparsed = self.unparsed[at:]
        if self.stage is not DialogueStage.IDLE:
            done = _DONE_ENDED.match(self.unparsed)
            if done:
                self.unparsed = self.unparsed[done.end() :]
                return [*events, self._done(done)]
        if len(self.unparsed) > LONGEST_LINE:
            self.unparsed = b""
            self.damaged += 1
        return events

    def quiet(self) -> list[Event]:
        """Returns a question, or a `done` without a line end. Call this method during silence."""
        if self.stage is DialogueStage.IDLE:
            text = _text(self.unparsed)
            question = text if _asks(text) else self._question
            return [Question(question)] if question else []
        done = _DONE.fullmatch(self.unparsed.rstrip())
        if not done:
            return []
        self.unparsed = b""
        return [self._done(done)]

    def _done(self, match: re.Match[bytes]) -> Done:
        self.stage, self.last_text = DialogueStage.IDLE, ""
        return Done(int(match[1]) if match[1] else None)

    def _line(self, line: bytes) -> list[Event]:
        text = _text(line)
        if not text:
            return []
        row = _row(text)
        if row is None:
            self.last_text = text
        if self.stage is DialogueStage.IDLE:
            self.stale += row is not None
            self._question = "" if row else text if _asks(text) else self._question
            return []
        self.lines += 1
        if self.stage is DialogueStage.HEADER:
            return self._head(text, row)
        return self._accept(row)

    def _head(self, text: str, row: LogRow | None) -> list[Event]:
        if row is not None and self.header.frequency is None:
            self.stale += 1
            return []
        if row is not None or text == COLUMNS:
            self.stage = DialogueStage.ROWS
            if row is None:
                return [self.header]
            self.damaged += 1  # the line of column names
            return [self.header, *self._accept(row)]
        for name, (pattern, unit) in _HEADER.items():
            match = pattern.fullmatch(text)
            if match:
                self.header = self.header._replace(**{name: unit * float(match[1])})
        return []

    def _accept(self, row: LogRow | None) -> list[Event]:
        """Returns the row if its number is plausible. A row's checksum omits the number."""
        if row is None:
            self.damaged += 1
            return []
        confirmed = row.number == self._candidate + 1
        self._candidate = row.number
        ahead = row.number - self.number
        if ahead < 1 or (ahead > MAX_UNCONFIRMED_GAP and not confirmed):
            self.damaged += 1
            return []
        if self.rows:
            self.lost += ahead - 1
        self.rows += 1
        self.number = row.number
        return [row]


def _text(line: bytes) -> str:
    return line.decode("ascii", "replace").strip()


def _asks(text: str) -> bool:
    return bool(_QUESTION.search(text)) and not _HEADER["frequency"][0].fullmatch(text)


def _row(text: str) -> LogRow | None:
    match = _ROW.fullmatch(text)
    if not match:
        return None
    number, fill, vent, pressure = (int(match[i]) for i in (1, 2, 3, 6))
    row = LogRow(number, fill, vent, float(match[4]), float(match[5]), pressure)
    # The error must be the command minus the pressure, so it serves as a checksum.
    valid = abs(row.command - row.pressure - row.error) < 0.015
    return row if valid and max(fill, vent) <= 255 and pressure <= 4095 else None
