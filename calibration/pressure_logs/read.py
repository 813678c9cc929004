"""Reads the pressure logs that the published firmware writes.

A log is a text file: a header with one `name value` pair per line, a line of column names, one row
per sample, and a last line `done<number>` with the number of earlier lines. Lines end in CR, LF or
CRLF. Source of the format: the public repository bvanstratum/SoftSnakePressureControl.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.pressure_logs.rows import COLUMNS, RowFinding, clean_rows
from slider_jax.errors import InputError
from slider_jax.io.toml import read_bytes

PSI_PER_COUNT = 0.13529
PSI_AT_ZERO = -12.4282
PA_PER_PSI = 6894.757
FEWEST_ROWS = 20

_NUMBER = r"([-+]?\d+(?:\.\d*)?)"
_HEADER = {
    "frequency": (re.compile(rf"frequency:?\s+{_NUMBER}\s*Hz", re.I), 0.01, 50.0, "Hz"),
    "start": (re.compile(rf"start time:?\s+{_NUMBER}\s*ms", re.I), 0.0, 1e10, "ms"),
    "stop": (re.compile(rf"stop time:?\s+{_NUMBER}\s*ms", re.I), 0.0, 1e10, "ms"),
    "period": (re.compile(rf"sample p(?:r|erio)d:?\s+{_NUMBER}\s*ms", re.I), 0.05, 100.0, "ms"),
    "cycles": (re.compile(rf"number cy(?:lc|cl)es:?\s+{_NUMBER}", re.I), 0.0, 1e6, ""),
}
_NEW_TEST = re.compile(r"-+\s*new test\s*-+", re.I)
_DONE = re.compile(r"done\s*(\d*)", re.I)


def psi(counts):
    """Returns the gauge pressure [psi] of `counts` of the rig's pressure sensor."""
    return PSI_PER_COUNT * counts + PSI_AT_ZERO


@dataclass(frozen=True)
class ManifoldLog:
    """One pressure log: arrays (samples,) at increasing times, and faults that `read_log` found.

    | field | unit | meaning |
    |---|---|---|
    | `frequency` | Hz | frequency of the sine command, from the header |
    | `period` | s | time between samples, from the header |
    | `t` | s | time since the first sample of the arrays |
    | `command`, `pressure` | counts | set pressure and measured pressure |
    | `fill`, `vent` | 0 to 255 | duty of the fill valve and the vent valve; 255: fully open |
    """

    path: Path
    frequency: float
    period: float
    t: np.ndarray
    command: np.ndarray
    pressure: np.ndarray
    fill: np.ndarray
    vent: np.ndarray
    findings: tuple[RowFinding, ...]

    @property
    def command_Pa(self) -> np.ndarray:
        """Commanded gauge pressure [Pa]."""
        return PA_PER_PSI * psi(self.command)

    @property
    def pressure_Pa(self) -> np.ndarray:
        """Measured gauge pressure [Pa]."""
        return PA_PER_PSI * psi(self.pressure)

    @property
    def cycles(self) -> float:
        """Number of periods of the command from the first to the last sample."""
        return float(self.t[-1] * self.frequency)


def read_log(path: Path | str) -> ManifoldLog:
    """Reads a log, repairs small faults, and lists the faults in `findings`.

    Raises `InputError` with file and line for faults that cannot be repaired: missing or unknown
    columns, a header without frequency or period, more than one test, too few valid rows, too many
    bad rows, a counter that decreases, or a gap longer than a tenth of a cycle.
    """
    path = Path(path)
    lines = _lines(path)
    columns_at = _find_columns(path, lines)
    values, findings = _header(path, lines[:columns_at])
    body, more = _body(path, lines, columns_at)
    findings += more
    period = values["period"] / 1000.0
    longest_gap = 0.1 / (values["frequency"] * period)
    rows, more = clean_rows(path, body, longest_gap)
    findings += more
    if len(rows) < FEWEST_ROWS:
        raise InputError(
            f"{path}: {len(rows)} usable rows; at least {FEWEST_ROWS} are needed; record a new log"
        )
    findings += _check_header(values, rows)
    number, fill, vent, command, _, pressure = rows.T
    t = (number - number[0]) * period
    findings += _check_frequency(values["frequency"], t, command)
    return ManifoldLog(
        path, values["frequency"], period, t, command, pressure, fill, vent, tuple(findings)
    )


def _lines(path: Path) -> list[tuple[int, str]]:
    """Returns the lines that are not blank, each with its line number."""
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise InputError(f"{path}: the file is not text; give a log of the published firmware")
    lines = [(i, s.strip()) for i, s in enumerate(re.split(r"\r\n|\r|\n", text), start=1)]
    lines = [(i, s) for i, s in lines if s]
    if not lines:
        raise InputError(f"{path}: the file is empty; record a new log")
    return lines


def _find_columns(path: Path, lines: list[tuple[int, str]]) -> int:
    """Returns the index of the line of column names."""
    named = [i for i, (_, text) in enumerate(lines) if re.match(r"[A-Za-z]\w*\s*,", text)]
    if not named:
        raise InputError(f"{path}: no line of column names; add the line {','.join(COLUMNS)}")
    line, text = lines[named[0]]
    names = tuple(cell.strip() for cell in text.split(","))
    if names != COLUMNS:
        raise InputError(
            f"{path}: line {line}: columns {','.join(names)}; allowed {','.join(COLUMNS)}; "
            "convert the file, or give a log of the published firmware"
        )
    if len(named) > 1:
        again = lines[named[1]]
        raise InputError(
            f"{path}: line {again[0]}: a second line of column names, {again[1]!r}; "
            "only one test is allowed; split the file at this line"
        )
    return named[0]


def _header(path: Path, lines: list[tuple[int, str]]) -> tuple[dict[str, float], list[RowFinding]]:
    values: dict[str, float] = {}
    findings = []
    for line, text in lines:
        for name, (pattern, low, high, unit) in _HEADER.items():
            match = pattern.fullmatch(text)
            if not match:
                continue
            value = float(match[1])
            if name in values:
                raise InputError(
                    f"{path}: line {line}: a second {name}; only one is allowed; split the file"
                )
            if not low <= value <= high:
                raise InputError.value(
                    f"{path}: line {line}: {name}", value, f"{low:g} to {high:g} {unit}".strip()
                )
            values[name] = value
            break
        else:
            if text.count(",") == len(COLUMNS) - 1:
                findings.append(RowFinding(line, f"stale row before the header, dropped: {text}"))
            elif not _NEW_TEST.fullmatch(text):
                findings.append(RowFinding(line, f"unknown header line, ignored: {text!r}"))
    for name, example in (("frequency", "frequency:    0.25 Hz"), ("period", "Sample Prd    2 ms")):
        if name not in values:
            raise InputError(
                f"{path}: the header has no {name}; add a line such as '{example}' above the "
                "column names"
            )
    return values, findings


def _body(
    path: Path, lines: list[tuple[int, str]], columns_at: int
) -> tuple[list[tuple[int, str]], list[RowFinding]]:
    """Returns the lines between the column names and `done`, and findings on the last lines."""
    body = lines[columns_at + 1 :]
    end = next((i for i, (_, text) in enumerate(body) if _DONE.fullmatch(text)), None)
    rows = body[:end]
    starts = [line for line, text in body if _NEW_TEST.fullmatch(text)]
    starts += [line for line, text in rows if _HEADER["frequency"][0].fullmatch(text)]
    if starts:
        raise InputError(
            f"{path}: line {min(starts)}: a second test begins; only one test is allowed; split "
            "the file at this line"
        )
    if end is None:
        text = "the file ends without 'done', so lines may be missing"
        return rows, [RowFinding(lines[-1][0], text)]
    findings = []
    (line, text), after = body[end], body[end + 1 :]
    counted, before = re.sub(r"\D", "", text), columns_at + 1 + end
    if counted and int(counted) != before:
        detail = f"'{text}' states {counted} earlier lines; the file has {before} earlier lines"
        findings.append(RowFinding(line, detail))
    if after:
        findings.append(RowFinding(after[0][0], f"{len(after)} lines after 'done' are ignored"))
    return rows, findings


def _check_header(values: dict[str, float], rows: np.ndarray) -> list[RowFinding]:
    """Returns findings if the header's start and stop time contradict its cycles or the rows."""
    details, last = [], int(rows[-1, 0])
    missing = {"start", "stop"} - values.keys()
    if missing:
        return [RowFinding(None, f"the header has no {' and no '.join(sorted(missing))} time")]
    span = values["stop"] - values["start"]
    expected = span / values["period"]
    if abs(expected - last) > 2.0:
        details = [f"the header implies {expected:g} samples; the last sample has number {last}"]
    cycles = span * values["frequency"] / 1000.0
    if "cycles" in values and abs(cycles - values["cycles"]) > 0.05:
        details += [f"start to stop is {cycles:.2f} cycles; the header states {values['cycles']:g}"]
    return [RowFinding(None, detail) for detail in details]


def _check_frequency(frequency: float, t: np.ndarray, command: np.ndarray) -> list[RowFinding]:
    """Returns a finding if the command contradicts the header's `frequency` [Hz].

    The command's frequency is the number of rises through the middle level per second.
    """
    level = command - 0.5 * (command.max() + command.min())
    up = np.flatnonzero((level[:-1] < 0) & (level[1:] >= 0))
    if len(up) < 2:
        detail = "the frequency is not checked, because the command has fewer than two cycles"
        return [RowFinding(None, detail)]
    crossing = t[up] - level[up] * (t[up + 1] - t[up]) / (level[up + 1] - level[up])
    found = (len(up) - 1) / (crossing[-1] - crossing[0])
    if abs(found / frequency - 1.0) <= 0.02:
        return []
    return [RowFinding(None, f"the command has {found:.4g} Hz; the header states {frequency:g} Hz")]
