"""Reads the markers of the arm's static runs."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slider_jax.errors import InputError
from slider_jax.io.toml import read_bytes

TENSIONS = ("u1_N", "u2_N")
MARKERS = tuple(f"p{i}{axis}_m" for i in (1, 2, 3, 4) for axis in "xyz")
HIGHEST = {**dict.fromkeys(TENSIONS, 100.0), **dict.fromkeys(MARKERS, 2.0)}
"""Largest size of the values in each column; the range detects a wrong unit."""


class ArmRuns(NamedTuple):
    """Static runs of the arm."""

    names: tuple[str, ...]
    tensions: np.ndarray
    """Tensions of both tendons (runs, 2) [N]."""
    markers: np.ndarray
    """Mean positions of the markers (runs, 4, 3) [m]."""
    sessions: tuple[str, ...]
    """Name of each run's session; empty if the file has no column `session`."""


def read_arm_runs(path: Path) -> ArmRuns:
    """Returns the runs of a file. Raises `InputError` if the file is invalid."""
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text (byte {error.start}); save as UTF-8") from None
    reader = csv.DictReader(io.StringIO(text))
    rows = list(reader)
    if not rows:
        raise InputError(f"{path}: no row; give a header and a row for each run")
    header = reader.fieldnames or ()
    missing = [name for name in ("name", *TENSIONS, *MARKERS) if name not in header]
    if missing:
        raise InputError(f"{path}: no column {missing[0]}; add this column")
    values = np.array([_numbers(row, f"{path}, line {k}") for k, row in enumerate(rows, start=2)])
    names = [row["name"] for row in rows]
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise InputError(f"{path}: the run {repeated[0]} has two rows; remove one")
    sessions = tuple(row.get("session") or "" for row in rows)
    if any(sessions) and not all(sessions):
        where = f"{path}, line {sessions.index('') + 2}, column session"
        raise InputError.value(where, "nothing", "a name in every row, or no column session")
    return ArmRuns(tuple(names), values[:, :2], values[:, 2:].reshape(-1, 4, 3), sessions)


def _numbers(row: dict[str, str | None], where: str) -> Sequence[float]:
    found = []
    for name in (*TENSIONS, *MARKERS):
        low, high = 0.0 if name in TENSIONS else -HIGHEST[name], HIGHEST[name]
        try:
            value = float(row[name] or "nothing")
        except ValueError:
            value = np.nan
        if not low <= value <= high:
            unit = name.rpartition("_")[2]
            raise InputError.value(
                f"{where}, column {name}", row[name] or "nothing", f"{low:g} to {high:g} {unit}"
            )
        found.append(value)
    return found
