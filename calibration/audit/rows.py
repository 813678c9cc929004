"""Rows of a measured trial, read one by one: what is damaged is told and left out."""

import csv
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calibration.measurements.findings import Finding
from slider_jax.channels import channel_columns
from slider_jax.errors import InputError
from slider_jax.io.toml import read_bytes

MOST_BAD = 0.5
"""A file with a larger share of bad rows is left out."""
FEWEST_ROWS = 20


class Rows(NamedTuple):
    """Rows in the file's order: times (n,) [s as written], and (5, n) of the other columns."""

    t: np.ndarray
    values: np.ndarray


class Unusable(Exception):
    """A trial cannot be used; holds the finding that says why."""

    def __init__(self, finding: Finding):
        super().__init__(str(finding))
        self.finding = finding


def unusable(
    trial: str,
    kind: str,
    detail: str,
    channel: str | None = None,
    span: tuple[float | None, float | None] = (None, None),
) -> Unusable:
    """The error that leaves a trial out."""
    return Unusable(Finding(trial, kind, channel, span[0], span[1], detail, "left out"))


def read_rows(path: Path) -> tuple[Rows, list[Finding]]:
    """The rows of a trial's CSV that can be read, and findings on the others.

    Cells that are blank or not finite numbers are NaN. Raises `Unusable` where no time column or
    too few rows are left.
    """
    name = path.name
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise unusable(name, "not_text", "the file is not UTF-8 text") from None
    except InputError as error:
        raise unusable(name, "not_text", f"the file cannot be read: {error}") from None
    try:
        rows = list(csv.reader(text.replace("\0", "\ufffd").splitlines()))
    except csv.Error as error:
        raise unusable(name, "not_text", f"the file is not a CSV table ({error})") from None
    numbered = [(line, row) for line, row in enumerate(rows, start=1) if row]
    if not numbered:
        raise unusable(name, "empty", "the file is empty")
    header = [cell.strip() for cell in numbered[0][1]]
    findings = _check_header(name, header)
    whole, more = _whole_rows(name, header, numbered[1:])
    table, worse = _numbers(name, header, whole)
    t = table[0]
    timed = np.isfinite(t)
    if not timed.all():
        detail = f"{np.sum(~timed)} rows have no time and are dropped"
        worse.append(Finding(name, "bad_cell", "t_s", None, None, detail, "masked"))
    lost = len(numbered) - 1 - int(timed.sum())
    if lost > MOST_BAD * len(numbered) or timed.sum() < FEWEST_ROWS:
        detail = (
            f"only {timed.sum()} of {len(numbered) - 1} rows can be read; at least {FEWEST_ROWS}, "
            f"and {1.0 - MOST_BAD:.0%} of all, are needed"
        )
        raise unusable(name, "bad_row" if lost else "few_rows", detail)
    return Rows(t[timed], table[1:, timed]), findings + more + worse


def _check_header(name: str, header: list[str]) -> list[Finding]:
    if "t_s" not in header:
        detail = f"the first line names no column t_s; it holds {', '.join(header)[:80]}"
        raise unusable(name, "missing_column", detail)
    twice = sorted({x for x in channel_columns() if header.count(x) > 1})
    if twice:
        detail = f"the first line names {', '.join(twice)} more than once"
        raise unusable(name, "missing_column", detail)
    findings = []
    for column in channel_columns()[1:]:
        if column not in header:
            other = [x for x in header if x not in channel_columns()]
            beside = f"; unknown to this program: {', '.join(other)[:80]}" if other else ""
            detail = f"the file has no column {column}{beside}; the others are used"
            findings.append(Finding(name, "missing_column", column, None, None, detail, "used"))
    return findings


def _whole_rows(name, header, numbered) -> tuple[list[list[str]], list[Finding]]:
    """Rows with as many cells as the header."""
    whole, findings, lines = [], [], []
    for position, (line, row) in enumerate(numbered):
        if len(row) == len(header):
            whole.append(row)
        elif position == len(numbered) - 1:
            detail = (
                f"the last line, {line}, is torn ({len(row)} of {len(header)} cells) and dropped"
            )
            findings.append(Finding(name, "torn_line", None, None, None, detail, "masked"))
        else:
            lines.append(line)
    if lines:
        detail = (
            f"{len(lines)} rows do not have {len(header)} cells and are dropped, first line "
            f"{lines[0]}"
        )
        findings.append(Finding(name, "bad_row", None, None, None, detail, "masked"))
    return whole, findings


def _numbers(name, header, rows) -> tuple[np.ndarray, list[Finding]]:
    """(6, rows) in the order of `channels.columns`."""
    table, findings = np.full((len(channel_columns()), len(rows)), np.nan), []
    for i, column in enumerate(channel_columns()):
        if column not in header:
            continue
        at, wrong = header.index(column), []
        for j, row in enumerate(rows):
            cell = row[at].strip()
            table[i, j] = _number(cell)
            if cell and not math.isfinite(table[i, j]):
                wrong.append(cell)
        if wrong:
            detail = (
                f"{len(wrong)} cells of {column} are not finite numbers ({wrong[0][:20]!r}"
                f"{', ...' if len(wrong) > 1 else ''}) and count as missing"
            )
            findings.append(Finding(name, "bad_cell", column, None, None, detail, "masked"))
    return table, findings


def _number(cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
