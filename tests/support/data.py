"""Finds the repository and the measured data, which tests read in place and never copy."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The repository."""


def data_dir() -> Path | None:
    """Returns the data folder: `SLIDER_DATA`, else `../shared/data`; None if there is none."""
    folder = Path(os.environ.get("SLIDER_DATA") or ROOT.parent / "shared" / "data")
    return folder if folder.is_dir() else None


def missing_in_ci() -> str | None:
    """Returns the error of a CI run without the data, or None if the run may go on.

    Tests that need the data skip without them, and a CI run would pass without those tests. A
    fork whose CI has no data sets `SLIDER_DATA_OPTIONAL=1`.
    """
    if os.environ.get("CI") != "true" or os.environ.get("SLIDER_DATA_OPTIONAL") == "1":
        return None
    if data_dir() is not None:
        return None
    given = os.environ.get("SLIDER_DATA") or "../shared/data"
    return (
        f"SLIDER_DATA: {given} is no folder; CI needs the measured data, since tests skip without "
        "them; set SLIDER_DATA to their folder, or SLIDER_DATA_OPTIONAL=1 to skip those tests"
    )
