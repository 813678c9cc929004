"""Parses the rows of a pressure log, and checks rows against each other."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slider_jax.errors import InputError

COLUMNS = (
    "N_sample",
    "fluidInVoltage",
    "fluidOutVoltage",
    "pressureCommanded",
    "pressureError",
    "pressure",
)
_RANGES = ((1, 1e9), (0, 255), (0, 255), (-1e4, 1e4), (-2e4, 2e4), (0, 4095))
MAX_BAD_SHARE = 0.05  # fraction of bad rows; a larger fraction indicates a damaged recording
MAX_STALE_ROWS = 5  # number of rows of an earlier test that may precede the first sample
STUCK_SAMPLES = 25  # with a noise of 1.7 counts, a working sensor does not repeat a code so often


class RowFinding(NamedTuple):
    """A fault of a log's file, and the fault's line number (None: not in a single line)."""

    line: int | None
    detail: str

    def __str__(self) -> str:
        return f"line {self.line}: {self.detail}" if self.line else self.detail


def clean_rows(
    path: Path, lines: list[tuple[int, str]], longest_gap: float
) -> tuple[np.ndarray, list[RowFinding]]:
    """Returns the valid rows (samples, 6) in the order of `COLUMNS`, and the findings.

    The counter N_sample increases strictly. Raises `InputError` if more than `MAX_BAD_SHARE` of the
    rows are bad, if the counter decreases, or if a gap exceeds `longest_gap` [samples].
    """
    rows, numbers, findings = [], [], []
    for position, (line, text) in enumerate(lines):
        row = _parse(text)
        if isinstance(row, str):
            kind = "incomplete last line" if position == len(lines) - 1 else "bad row"
            findings.append(RowFinding(line, f"{kind}, dropped ({row}): {text[:60]}"))
        else:
            rows.append(row)
            numbers.append(line)
    if len(findings) > max(1.0, MAX_BAD_SHARE * len(lines)):
        raise InputError(
            f"{path}: {findings[0]}; {len(findings)} of {len(lines)} rows are bad, allowed "
            f"{MAX_BAD_SHARE:.0%}; record a new log"
        )
    table = np.array(rows, dtype=float).reshape(-1, len(COLUMNS))
    table, numbers, more = _without_stale(table, numbers)
    findings += more
    table, more = _in_order(path, table, numbers, longest_gap)
    return table, findings + more + _stuck(table)


def _parse(text: str) -> list[float] | str:
    """Returns the six numbers of a row, or the fault of the row as text."""
    cells = [cell.strip() for cell in text.split(",")]
    if len(cells) != len(COLUMNS):
        return f"{len(cells)} cells instead of {len(COLUMNS)}"
    row = []
    for name, cell, (low, high) in zip(COLUMNS, cells, _RANGES, strict=True):
        try:
            value = float(cell)
        except ValueError:
            return f"{name} is not a number"
        if not math.isfinite(value):
            return f"{name} is not finite"
        if not low <= value <= high:
            return f"{name} is outside {low:g} to {high:g}"
        row.append(value)
    if row[0] != int(row[0]):
        return "N_sample is not a whole number"
    # In an undamaged row, the fourth value minus the sixth equals the fifth.
    if abs(row[3] - row[5] - row[4]) > 0.02:
        return "pressureError differs from pressureCommanded - pressure"
    return row


def _without_stale(
    table: np.ndarray, lines: list[int]
) -> tuple[np.ndarray, list[int], list[RowFinding]]:
    """Returns rows and line numbers without stale rows, and a finding for each stale row.

    A stale row is a row of an earlier test that was still in the serial buffer at the start.
    """
    drop = 0
    falls = np.flatnonzero(np.diff(table[: MAX_STALE_ROWS + 1, 0]) < 0)
    if falls.size and table[falls[-1] + 1, 0] <= MAX_STALE_ROWS:
        drop = int(falls[-1]) + 1
    elif len(table) > 2 * MAX_STALE_ROWS:
        bend = np.abs(np.diff(table[:, 3], 2))
        if bend[0] > 5.0 > 4.0 * bend[1:].max():
            drop = 1
    findings = [RowFinding(line, "stale row of an earlier test, dropped") for line in lines[:drop]]
    return table[drop:], lines[drop:], findings


def _in_order(
    path: Path, table: np.ndarray, lines: list[int], longest_gap: float
) -> tuple[np.ndarray, list[RowFinding]]:
    """Returns the rows without repeated samples, and findings on repeated and missing samples."""
    if not len(table):
        return table, []
    findings = []
    if table[0, 0] != 1:
        findings.append(RowFinding(lines[0], f"the first valid sample is number {table[0, 0]:.0f}"))
    keep = np.ones(len(table), bool)
    last = table[0, 0]
    for i in range(1, len(table)):
        now = table[i, 0]
        step = now - last
        if step == 0:
            keep[i] = False
            findings.append(RowFinding(lines[i], f"sample {now:.0f} is repeated, dropped"))
            continue
        if step < 0:
            raise InputError(
                f"{path}: line {lines[i]}: N_sample decreases from {last:.0f} to {now:.0f}; "
                "N_sample must increase; split the file at this line, or remove the wrong rows"
            )
        if step > 1:
            detail = f"{step - 1:.0f} samples are missing between {last:.0f} and {now:.0f}"
            if step > longest_gap:
                raise InputError(
                    f"{path}: line {lines[i]}: {detail}, more than a tenth of a cycle; "
                    "cut the log at this line or record a new log"
                )
            findings.append(RowFinding(lines[i], detail))
        last = now
    return table[keep], findings


def _stuck(table: np.ndarray) -> list[RowFinding]:
    """Returns a finding for each series of `STUCK_SAMPLES` or more samples with equal pressure."""
    if not len(table):
        return []
    pressure = table[:, 5]
    edges = np.flatnonzero(np.diff(pressure)) + 1
    starts, ends = np.r_[0, edges], np.r_[edges, len(pressure)]
    return [
        RowFinding(None, f"pressure stuck at {pressure[a]:.0f} counts for {b - a} samples, from "
                f"sample {table[a, 0]:.0f} on")
        for a, b in zip(starts, ends, strict=True)
        if b - a >= STUCK_SAMPLES
    ]  # fmt: skip
