"""Writes the record of a benchmark: its figures, and the machine, commit and versions behind them.

`docs/generate/performance.py` makes docs/reference/performance.md from the records in
`benchmarks/results`. To renew figures, run their benchmark with the command in their record.
"""

import os
import platform
import subprocess
import sys
from datetime import date
from pathlib import Path
from typing import Any

from slider_jax.io.files import versions, write_json

ROOT = Path(__file__).resolve().parents[1]


def cpu_name() -> str:
    """Returns the processor's name, if the system reports a name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(x.split(":")[1].strip() for x in lines if x.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def commit() -> str:
    """Returns the commit of the sources, with "and changes" if files differ from this commit."""

    def git(*words: str) -> str:
        run = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
        return run.stdout.strip()

    changed = git("status", "--porcelain", "--untracked-files=no", "*.py", "*.cc")
    return git("rev-parse", "--short=8", "HEAD") + (" and changes" if changed else "")


AT_START = commit()
"""The sources may change while a benchmark runs."""


def write_record(out: Path, figures: dict[str, Any], note: str = "") -> None:
    """Writes `figures`, and what they depend on, as JSON to `out`.

    `note` states in one sentence how the figures were measured.
    """
    here, *words = sys.argv
    shown = [f"benchmarks/{Path(here).name}", *words]
    machine = {
        "processor": cpu_name(),
        "cores": os.cpu_count(),
        "load": [round(x, 2) for x in os.getloadavg()],
        "system": f"{platform.system()} on {platform.machine()}",
    }
    record = {
        "command": f"python {' '.join(shown)}",
        "commit": AT_START,
        "date": date.today().isoformat(),
        "machine": machine,
        "note": note,
        "versions": versions(),
        "figures": figures,
    }
    write_json(out, record)
