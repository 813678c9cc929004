"""Where the measured data lie. They are read in place and never copied into the project."""

import os
from pathlib import Path


def data_dir() -> Path | None:
    """The data: `SLIDER_DATA`, else `../shared/data` beside the repository; None if absent."""
    root = Path(__file__).resolve().parents[2]
    folder = Path(os.environ.get("SLIDER_DATA") or root.parent / "shared" / "data")
    return folder if folder.is_dir() else None
