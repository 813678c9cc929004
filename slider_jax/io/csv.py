"""Reads CSV files with named columns of numbers. Errors name the file and the line."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from slider_jax.errors import InputError
from slider_jax.io.toml import read_bytes
from slider_jax.io.units import Quantity


def read_csv(
    path: Path, required: Sequence[str], blank: Sequence[str] = (), increasing: str = "time"
) -> dict[str, np.ndarray]:
    """Returns the columns as `read_table` does, and checks that the column `required[0]` increases.

    `increasing` names the column's quantity in errors. Raises `InputError` with file and line.
    """
    columns, lines = _read(path, required, blank)
    _check_increase(path, columns[required[0]], lines, required[0], increasing)
    return columns


POSITION = "s_m"
"""Column of a profile: the distance [m] from the near end."""


def read_profile(
    path: Path, length: float, quantities: Mapping[str, Quantity], owner: str
) -> dict[str, np.ndarray]:
    """Returns the columns of a profile along a body: `POSITION` and some of `quantities`.

    `quantities` contains the unit and the range of each column. The positions cover 0 to `length`
    [m], the length of the `owner`, such as "rod". Raises `InputError` with file and line.
    """
    columns, lines = _read(path, (POSITION,), tuple(quantities))
    header = path.read_text(encoding="utf-8-sig").partition("\n")[0].strip().split(",")
    unknown = [name for name in map(str.strip, header) if name not in (POSITION, *quantities)]
    if unknown or len(columns) == 1:
        given = f"unknown column {unknown[0]}" if unknown else "no property"
        raise InputError(f"{path}: {given}; allowed columns: {POSITION}, {', '.join(quantities)}")
    at = columns[POSITION]
    _check_increase(path, at, lines, POSITION, "the distance")
    if abs(at[0]) > 1e-6 or abs(at[-1] - length) > 1e-6:
        raise InputError(
            f"{path}: {POSITION} covers {at[0]:g} to {at[-1]:g} m; allowed 0 to {length:g} m, the "
            f"length of the {owner}; correct the profile or the length"
        )
    for name, quantity in quantities.items():
        for line, x in zip(lines, columns.get(name, ()), strict=False):
            if not quantity.low <= x <= quantity.high:
                raise InputError.value(
                    f"{path}, line {line}, column {name}", f"{x:g}", quantity.allowed,
                    quantity.advice,
                )  # fmt: skip
    return columns


def _check_increase(path: Path, values: np.ndarray, lines, name: str, increasing: str) -> None:
    falls = np.flatnonzero(np.diff(values) <= 0.0)
    if falls.size:
        raise InputError(
            f"{path}, line {lines[falls[0] + 1]}: {name} = {values[falls[0] + 1]:g} after "
            f"{values[falls[0]]:g}; {increasing} must increase from row to row"
        )


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
