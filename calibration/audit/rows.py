"""Reads the rows of a measured trial's CSV file and drops damaged rows."""

import csv
import math
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calibration.measurements.records import Finding
from slider_jax.channels import ChannelSet
from slider_jax.errors import InputError
from slider_jax.io.toml import read_bytes

MAX_BAD_SHARE = 0.5
"""A file with a larger fraction of damaged rows is not used."""
MIN_ROWS = 20


class Rows(NamedTuple):
    """Times (n,) and readings (channels, n) of a trial's file, in the order of the file's rows."""

    t: np.ndarray
    values: np.ndarray
    channels: ChannelSet


class Unusable(Exception):
    """Raised for an unusable trial; `finding` contains the reason."""

    def __init__(
        self,
        trial: str,
        kind: str,
        detail: str,
        channel: str | None = None,
        span: tuple[float | None, float | None] = (None, None),
    ):
        self.finding = Finding(trial, kind, channel, *span, detail, "left out")
        super().__init__(str(self.finding))


def read_rows(path: Path, channels: ChannelSet) -> tuple[Rows, list[Finding]]:
    """Returns the readable rows of a trial's CSV file, and findings on the file's faults.

    Cells that are blank or not finite numbers become NaN. Raises `Unusable` if the time column is
    missing or too few rows are readable.
    """
    name = path.name
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise Unusable(name, "not_text", "the file is not UTF-8 text") from None
    except InputError as error:
        raise Unusable(name, "not_text", f"the file is not readable: {error}") from None
    try:
        rows = list(csv.reader(text.replace("\0", "\ufffd").splitlines()))
    except csv.Error as error:
        raise Unusable(name, "not_text", f"the file is not a CSV table ({error})") from None
    numbered = [(line, row) for line, row in enumerate(rows, start=1) if row]
    if not numbered:
        raise Unusable(name, "empty", "the file is empty")
    header = [cell.strip() for cell in numbered[0][1]]
    findings = _check_header(name, header, channels.columns)
    whole, more = _whole_rows(name, header, numbered[1:])
    table, worse = _numbers(name, header, whole, channels.columns)
    t = table[0]
    timed = np.isfinite(t)
    if not timed.all():
        detail = f"{np.sum(~timed)} rows have no time and are dropped"
        worse.append(Finding(name, "bad_cell", "t_s", None, None, detail, "masked"))
    lost = len(numbered) - 1 - int(timed.sum())
    if lost > MAX_BAD_SHARE * len(numbered) or timed.sum() < MIN_ROWS:
        detail = (
            f"only {timed.sum()} of {len(numbered) - 1} rows are readable; at least {MIN_ROWS} "
            f"rows and {1.0 - MAX_BAD_SHARE:.0%} of all rows must be readable"
        )
        raise Unusable(name, "bad_row" if lost else "few_rows", detail)
    return Rows(t[timed], table[1:, timed], channels), findings + more + worse


def _check_header(name: str, header: list[str], columns: Sequence[str]) -> list[Finding]:
    if "t_s" not in header:
        detail = f"the first line has no column t_s; its columns are {', '.join(header)[:80]}"
        if len(header) == 1 and ";" in header[0]:
            detail += "; separate the cells with commas, and write decimals with points"
        raise Unusable(name, "missing_column", detail)
    repeated = sorted({x for x in columns if header.count(x) > 1})
    if repeated:
        detail = f"the first line repeats {', '.join(repeated)}"
        raise Unusable(name, "missing_column", detail)
    findings = []
    for column in columns[1:]:
        if column not in header:
            unknown = [x for x in header if x not in columns]
            ignored = f"; unknown columns {', '.join(unknown)[:80]} are ignored" if unknown else ""
            near = get_close_matches(column, unknown, 1)
            hint = f"; rename {near[0]} if it is {column}" if near else ""
            detail = (
                f"the file has no column {column}, so this sensor is not used{ignored}{hint}; the "
                "other columns are used"
            )
            findings.append(Finding(name, "missing_column", column, None, None, detail, "used"))
    return findings


def _whole_rows(name, header, numbered) -> tuple[list[list[str]], list[Finding]]:
    """Returns the rows with as many cells as the header, and findings on the other rows."""
    whole, findings, lines = [], [], []
    for position, (line, row) in enumerate(numbered):
        if len(row) == len(header):
            whole.append(row)
        elif position == len(numbered) - 1:
            detail = f"the last line, {line}, has {len(row)} of {len(header)} cells and is dropped"
            findings.append(Finding(name, "torn_line", None, None, None, detail, "masked"))
        else:
            lines.append(line)
    if lines:
        detail = (
            f"{len(lines)} rows do not have {len(header)} cells and are dropped; the first such "
            f"row is line {lines[0]}"
        )
        findings.append(Finding(name, "bad_row", None, None, None, detail, "masked"))
    return whole, findings


def _numbers(name, header, rows, columns) -> tuple[np.ndarray, list[Finding]]:
    """Returns the numbers (columns, rows) in the order of `columns`, and findings."""
    table, findings = np.full((len(columns), len(rows)), np.nan), []
    for i, column in enumerate(columns):
        if column not in header:
            continue
        at = header.index(column)
        cells = [row[at].strip() for row in rows]
        try:
            table[i] = list(map(float, cells))
        except ValueError:
            table[i] = list(map(_number, cells))
        table[i, ~np.isfinite(table[i])] = np.nan
        wrong = [cells[j] for j in np.flatnonzero(np.isnan(table[i])) if cells[j]]
        if wrong:
            detail = (
                f"{len(wrong)} of {len(rows)} cells of {column} are not finite numbers "
                f"({wrong[0][:20]!r}"
                f"{', ...' if len(wrong) > 1 else ''}) and count as missing"
            )
            findings.append(Finding(name, "bad_cell", column, None, None, detail, "masked"))
    return table, findings


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
