"""Reads CSV files with named columns of numbers. Errors name the file and the line."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slider_jax.errors import InputError
from slider_jax.io.toml import read_bytes


def read_csv(
    path: Path, required: Sequence[str], blank: Sequence[str] = (), increasing: str = "time"
) -> dict[str, np.ndarray]:
    """Returns the columns as `read_table` does, and checks that the column `required[0]` increases.

    `increasing` names the column's quantity in errors. Raises `InputError` with file and line.
    """
    columns, lines = _read(path, required, blank)
    times = columns[required[0]]
    falls = np.flatnonzero(np.diff(times) <= 0.0)
    if falls.size:
        line = lines[falls[0] + 1]
        raise InputError(
            f"{path}, line {line}: {required[0]} = {times[falls[0] + 1]:g} after "
            f"{times[falls[0]]:g}; {increasing} must increase from row to row"
        )
    return columns


def read_table(
    path: Path, required: Sequence[str], blank: Sequence[str] = ()
) -> dict[str, np.ndarray]:
    """Returns the columns of a CSV file by name. Empty cells in the columns `blank` become NaN.

    Raises `InputError` with file and line.
    """
    return _read(path, required, blank)[0]


def _read(
    path: Path, required: Sequence[str], blank: Sequence[str]
) -> tuple[dict[str, np.ndarray], list[int]]:
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text (byte {error.start}); save as UTF-8") from None
    rows = list(csv.reader(text.splitlines()))
    if not rows:
        raise InputError(f"{path}: the file is empty; add a header with {', '.join(required)}")
    header = [name.strip() for name in rows[0]]
    for name in required:
        if name not in header:
            raise InputError(
                f"{path}, line 1: column {name} is missing; given {', '.join(header)}; "
                f"needed {', '.join(required)}"
            )
    numbered = [(line, row) for line, row in enumerate(rows[1:], start=2) if row]
    if len(numbered) < 2:
        raise InputError(f"{path}: {len(numbered)} rows under the header; at least 2 are needed")
    for line, row in numbered:
        if len(row) != len(header):
            raise InputError(f"{path}, line {line}: {len(row)} cells; the header has {len(header)}")
    columns = {}
    for index, name in enumerate(header):
        if name in required or name in blank:
            cells = [(line, row[index]) for line, row in numbered]
            columns[name] = _numbers(path, name, cells, blank=name in blank)
    return columns, [line for line, _ in numbered]


def _numbers(path: Path, name: str, cells: list[tuple[int, str]], blank: bool) -> np.ndarray:
    values = np.empty(len(cells))
    for position, (line, cell) in enumerate(cells):
        where = f"{path}, line {line}, column {name}"
        text = cell.strip()
        if blank and not text:
            values[position] = np.nan
            continue
        try:
            values[position] = float(text)
        except ValueError:
            raise InputError(f"{where}: given {text!r}; allowed a number") from None
        if not np.isfinite(values[position]):
            raise InputError(f"{where}: given {text}; allowed a finite number")
    return values
