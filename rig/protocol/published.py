"""What the authors' published firmware says on its line, from bytes to numbers.

It asks for a frequency and waits. Then it runs one test: a header of one `name value` pair a line,
a line of column names, a row a sample, and a last line `done`, which may count the lines before it.
Lines end in CR, LF or CRLF. Source: the public repository bvanstratum/SoftSnakePressureControl and
the logs of its sweep of 2022-12-21. In these no count and no line end follows `done`, and a row may
stand before the header. The words of the question are not in them.
"""

import re
from enum import Enum
from typing import NamedTuple

COLUMNS = "N_sample,fluidInVoltage,fluidOutVoltage,pressureCommanded,pressureError,pressure"
PSI_PER_COUNT = 0.13529
PSI_AT_ZERO = -12.4282
PA_PER_PSI = 6894.757
LONGEST = 512
"""Most bytes without a line end: more are noise."""
LEAP = 50
"""Samples that may be missing before a row without its follower confirming it."""

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
# Its line end if it has one, and else a question right behind; a last CR waits for its LF.
_DONE_ENDED = re.compile(_DONE.pattern + rb"(?:\r\n|\n|\r(?=[^\n])|(?=[^\d\s]))", re.I)
_QUESTION = re.compile(r"freq|hz", re.I)
_END = re.compile(rb"\r\n|\r|\n")


def counts_to_pascal(counts: float) -> float:
    """Gauge pressure [Pa] of ADC `counts`."""
    return PA_PER_PSI * (PSI_PER_COUNT * counts + PSI_AT_ZERO)


class Question(NamedTuple):
    """The firmware asks for a frequency, and waits for it."""

    text: str


class Header(NamedTuple):
    """Of a test [Hz, s]; None for a line that did not come, or was torn."""

    frequency: float | None = None
    start: float | None = None
    stop: float | None = None
    period: float | None = None
    cycles: float | None = None


class LogRow(NamedTuple):
    """A sample. Pressures and error (command less pressure) in ADC counts, valves in 0 to 255."""

    number: int
    fill: int
    vent: int
    command: float
    error: float
    pressure: int

    @property
    def command_Pa(self) -> float:
        """Set gauge pressure [Pa]."""
        return counts_to_pascal(self.command)

    @property
    def pressure_Pa(self) -> float:
        """Measured gauge pressure [Pa]."""
        return counts_to_pascal(self.pressure)


class Done(NamedTuple):
    """The test's end; `counted` is what the firmware says it wrote, in lines, if it does."""

    counted: int | None


Event = Question | Header | LogRow | Done


class DialogueStage(Enum):
    """Where the dialogue is."""

    IDLE = "before an answer"
    HEADER = "answered; rows that come now are of an earlier test"
    ROWS = "the test runs"


class Dialogue:
    """Parser of the stream, in pieces of any size. Counts are of the test under way."""

    def __init__(self) -> None:
        self.rest = b""
        """Bytes that came and are not parsed: of a line not ended, or behind a test's end."""
        self.said = ""
        """The last line that was no row."""
        self._asked = ""
        self._begin(DialogueStage.IDLE)

    def _begin(self, stage: DialogueStage) -> None:
        self.stage, self.header = stage, Header()
        self.lines = 0
        """Lines of the test, blank ones and `done` not counted."""
        self.rows = self.torn = self.stale = self.lost = 0
        """Accepted, damaged, and of an earlier test; samples missing between accepted rows."""
        self.number = 0
        """Of the last row that was accepted."""
        self._candidate = 0

    def answered(self) -> None:
        """The frequency has been sent: what comes from now on is a test."""
        self._begin(DialogueStage.HEADER)
        self.rest, self.said, self._asked = b"", "", ""

    def feed(self, piece: bytes) -> list[Event]:
        """What this piece completes, up to a test's end; what follows that stays in `rest`."""
        self.rest += piece
        found: list[Event] = []
        at = 0
        for end in _END.finditer(self.rest):
            if self.stage is not DialogueStage.IDLE and _DONE.match(self.rest, at):
                break
            found += self._line(self.rest[at : end.start()])
            at = end.end()
        self.rest = self.rest[at:]
        if self.stage is not DialogueStage.IDLE:
            done = _DONE_ENDED.match(self.rest)
            if done:
                self.rest = self.rest[done.end() :]
                return [*found, self._done(done)]
        if len(self.rest) > LONGEST:
            self.rest = b""
            self.torn += 1
        return found

    def quiet(self) -> list[Event]:
        """What the line's silence completes: a question, or a `done` that no line end follows."""
        if self.stage is DialogueStage.IDLE:
            text = _text(self.rest)
            question = text if _asks(text) else self._asked
            return [Question(question)] if question else []
        done = _DONE.fullmatch(self.rest.rstrip())
        if not done:
            return []
        self.rest = b""
        return [self._done(done)]

    def _done(self, match: re.Match[bytes]) -> Done:
        self.stage, self.said = DialogueStage.IDLE, ""
        return Done(int(match[1]) if match[1] else None)

    def _line(self, line: bytes) -> list[Event]:
        text = _text(line)
        if not text:
            return []
        row = _row(text)
        if row is None:
            self.said = text
        if self.stage is DialogueStage.IDLE:
            self.stale += row is not None
            self._asked = "" if row else text if _asks(text) else self._asked
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
            self.torn += 1  # the line of column names
            return [self.header, *self._accept(row)]
        for name, (pattern, unit) in _HEADER.items():
            match = pattern.fullmatch(text)
            if match:
                self.header = self.header._replace(**{name: unit * float(match[1])})
        return []

    def _accept(self, row: LogRow | None) -> list[Event]:
        """The row if it is sound and follows; nothing but the order tells of a damaged number."""
        if row is None:
            self.torn += 1
            return []
        follows = row.number == self._candidate + 1
        self._candidate = row.number
        ahead = row.number - self.number
        if ahead < 1 or (ahead > LEAP and not follows):
            self.torn += 1
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
    # The firmware writes the three separately, so the error is a checksum of command and pressure.
    sound = abs(row.command - row.pressure - row.error) < 0.015
    return row if sound and max(fill, vent) <= 255 and pressure <= 4095 else None
