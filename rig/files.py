"""Writes files atomically: a file is complete or does not exist."""

import json
import math
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np


def save_text(path: Path, text: str) -> None:
    """Writes `text` to a temporary file beside `path`, then renames that file to `path`."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".tmp-", suffix=path.suffix)
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
        os.chmod(name, 0o644)
        os.replace(name, path)
    finally:
        Path(name).unlink(missing_ok=True)


def save_json(path: Path, content: Mapping[str, Any]) -> None:
    """Writes `content` to `path` as JSON. Raises `ValueError` for a number that is not finite."""
    save_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def save_csv(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Writes `columns` (name with unit -> values (n,)) to `path`. A NaN becomes an empty cell."""
    cells = [["" if math.isnan(x) else f"{x:.9g}" for x in v.tolist()] for v in columns.values()]
    rows = [",".join(columns), *(",".join(row) for row in zip(*cells, strict=True))]
    save_text(path, "\n".join(rows) + "\n")
