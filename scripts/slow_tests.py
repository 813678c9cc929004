"""Runs all slow tests and prints a table with test, outcome and seconds.

    python scripts/slow_tests.py [PYTEST ARGUMENTS]

The script passes its arguments to pytest, for example `-n 3` (the default) or a folder of tests.
The exit code is the exit code of pytest.
"""

import subprocess
import sys
import tempfile
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]


def outcome(case: ElementTree.Element) -> str:
    """Returns the outcome of one test in pytest's XML report: passed, failed, error or skipped."""
    for kind in ("failure", "error", "skipped"):
        if case.find(kind) is not None:
            return {"failure": "failed"}.get(kind, kind)
    return "passed"


def results_table(report: Path) -> str:
    """Returns a Markdown table of the tests in pytest's XML report, the slowest first."""
    cases = list(ElementTree.parse(report).iter("testcase"))
    cases.sort(key=lambda case: -float(case.get("time", 0.0)))
    lines = ["| test | outcome | seconds |", "|---|---|---|"]
    for case in cases:
        place = case.get("classname", "").removeprefix("tests.").replace(".", "/")
        seconds = float(case.get("time", 0.0))
        lines.append(f"| {place} {case.get('name')} | {outcome(case)} | {seconds:.0f} |")
    return "\n".join(lines)


def main(arguments: list[str]) -> int:
    """Runs pytest on the slow tests, prints the table, and returns pytest's exit code."""
    parallel = [] if any(x.startswith("-n") for x in arguments) else ["-n", "3"]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "slow.xml"
        command = [sys.executable, "-m", "pytest", "-q", "-m", "slow", f"--junitxml={report}"]
        code = subprocess.run([*command, *parallel, *arguments], cwd=ROOT).returncode
        if report.exists():
            print(results_table(report))
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
