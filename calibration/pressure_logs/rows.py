"""Rows of a pressure log: parsed one by one, then checked against each other."""

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
MOST_BAD = 0.05
STALE = 5
STUCK = 25


class RowFinding(NamedTuple):
    """Something in the file that was mended, dropped or does not agree."""

    line: int | None
    what: str

    def __str__(self) -> str:
        return f"line {self.line}: {self.what}" if self.line else self.what


def clean_rows(
    path: Path, lines: list[tuple[int, str]], longest_gap: float
) -> tuple[np.ndarray, list[RowFinding]]:
    """Rows (samples, 6) in the order of `COLUMNS`, with a strictly increasing counter.

    `longest_gap` is in samples. Raises `InputError` where more than `MOST_BAD` of the rows are bad,
    where the counter falls or where a gap is longer.
    """
    rows, numbers, findings = [], [], []
    for position, (line, text) in enumerate(lines):
        row = _parse(text)
        if isinstance(row, str):
            torn = "torn last line" if position == len(lines) - 1 else "bad row"
            findings.append(RowFinding(line, f"{torn}, dropped ({row}): {text[:60]}"))
        else:
            rows.append(row)
            numbers.append(line)
    if len(findings) > max(1.0, MOST_BAD * len(lines)):
        raise InputError(
            f"{path}: {findings[0]}; {len(findings)} of {len(lines)} rows are bad, allowed "
            f"{MOST_BAD:.0%}; record again"
        )
    table = np.array(rows, dtype=float).reshape(-1, len(COLUMNS))
    table, numbers, more = _without_stale(table, numbers)
    findings += more
    table, more = _in_order(path, table, numbers, longest_gap)
    return table, findings + more + _stuck(table)


def _parse(text: str) -> list[float] | str:
    """The row's six numbers, or what is wrong with it."""
    cells = [cell.strip() for cell in text.split(",")]
    if len(cells) != len(COLUMNS):
        return f"{len(cells)} cells, expected {len(COLUMNS)}"
    row = []
    for name, cell, (low, high) in zip(COLUMNS, cells, _RANGES, strict=True):
        try:
            value = float(cell)
        except ValueError:
            return f"{name} is not a number"
        if not math.isfinite(value):
            return f"{name} is not finite"
        if not low <= value <= high:
            return f"{name} outside {low:g} to {high:g}"
        row.append(value)
    if row[0] != int(row[0]):
        return "N_sample is not whole"
    # The firmware writes the three separately, so the error is a checksum of command and pressure.
    if abs(row[3] - row[5] - row[4]) > 0.02:
        return "pressureError is not pressureCommanded - pressure"
    return row


def _without_stale(
    table: np.ndarray, lines: list[int]
) -> tuple[np.ndarray, list[int], list[RowFinding]]:
    """Without the rows of an earlier test that the serial buffer still held at the start."""
    drop = 0
    falls = np.flatnonzero(np.diff(table[: STALE + 1, 0]) < 0)
    if falls.size and table[falls[-1] + 1, 0] <= STALE:
        drop = int(falls[-1]) + 1
    elif len(table) > 2 * STALE:
        bend = np.abs(np.diff(table[:, 3], 2))
        if bend[0] > 5.0 > 4.0 * bend[1:].max():
            drop = 1
    findings = [RowFinding(line, "stale row of an earlier test, dropped") for line in lines[:drop]]
    return table[drop:], lines[drop:], findings


def _in_order(
    path: Path, table: np.ndarray, lines: list[int], longest_gap: float
) -> tuple[np.ndarray, list[RowFinding]]:
    """With each counter value once; gaps are told."""
    if not len(table):
        return table, []
    findings = []
    if table[0, 0] != 1:
        findings.append(RowFinding(lines[0], f"the first sample kept is number {table[0, 0]:.0f}"))
    keep = np.ones(len(table), bool)
    last = table[0, 0]
    for i in range(1, len(table)):
        now = table[i, 0]
        step = now - last
        if step == 0:
            keep[i] = False
            findings.append(RowFinding(lines[i], f"sample {now:.0f} a second time, dropped"))
            continue
        if step < 0:
            raise InputError(
                f"{path}: line {lines[i]}: N_sample falls from {last:.0f} to {now:.0f}; it must "
                "increase: split the file there or remove the rows"
            )
        if step > 1:
            what = f"{step - 1:.0f} samples missing between {last:.0f} and {now:.0f}"
            if step > longest_gap:
                raise InputError(
                    f"{path}: line {lines[i]}: {what}, more than a tenth of a cycle; "
                    "cut the log there or record again"
                )
            findings.append(RowFinding(lines[i], what))
        last = now
    return table[keep], findings


def _stuck(table: np.ndarray) -> list[RowFinding]:
    """Runs of the same pressure that sensor noise makes impossible."""
    if not len(table):
        return []
    pressure = table[:, 5]
    edges = np.flatnonzero(np.diff(pressure)) + 1
    starts, ends = np.r_[0, edges], np.r_[edges, len(pressure)]
    return [
        RowFinding(None, f"pressure stuck at {pressure[a]:.0f} counts for {b - a} samples from "
                f"sample {table[a, 0]:.0f}")
        for a, b in zip(starts, ends, strict=True)
        if b - a >= STUCK
    ]  # fmt: skip
