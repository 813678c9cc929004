"""Compares `slider rig loop` with a fixed series of trials on a rig with two hidden effects.

    python benchmarks/rig_loop.py --out DIR

The hidden effects are a valve overlap of 4 kPa and a current of 5 cm/s in the tank. The loop's
experiment file contains neither effect, and wrong values of all four base parameters. The loop and
the fixed series (the sweep) begin with the same three trials. The loop then chooses further trials.
The sweep varies the frequency at each pressure, and `slider close-loop` runs on the sweep's first
COUNTS trials. The simulated rig runs in real time behind a pseudo-terminal and UDP. An interrupted
run resumes when you repeat the command.
"""

import argparse
import json
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rig_process import command, simulated

BUDGET = 12
SWEEP = [
    {"frequency": f, "amplitude": a, "phase": 0.1, "duration": 2.0}
    for a in (150e3, 75e3, 225e3)
    for f in (1.0, 2.0, 3.0, 4.0)
]
BEGIN = SWEEP[:3]
RANGES = ("--frequency", 0.75, 5.5, "--amplitude", 60e3, 230e3, "--phase", -0.3, 0.3)
"""Ranges of the trials that the loop may choose."""
HIDDEN = {"valve_overlap": {"band": 4e3}, "tank_current": {"U_x": -0.05}}
TRUE = {"C_d": 3.0, "m_a": 0.62, "k": 0.075, "K_Q": 4.6e-7}
GIVEN = {"C_d": 2.5, "m_a": 0.5, "k": 0.06, "K_Q": 4.2e-7}
ROBOT = """name = "hidden"

[robot]
body_length = 0.298
tail_length = 0.07
linear_density = 0.7
EI_body = 0.038
EI_tail = 0.0058
damping_time = 0.002
height = 0.03
front_chamber = [0.02, 0.145]
rear_chamber = [0.155, 0.28]

[sensors]
start_swing = 2e-4

"""


def toml_table(name: str, values: dict[str, Any]) -> str:
    """Returns a TOML table."""
    lines = [f"{key} = {json.dumps(x)}" for key, x in values.items()]
    return "\n".join([name, *lines, "", ""])


def experiment(
    parameters: dict[str, float], effects: dict[str, dict], trials: Sequence[dict[str, float]]
) -> str:
    """Returns the text of an experiment file with the given parameters, effects and trials."""
    text = ROBOT + toml_table("[parameters]", parameters)
    for name, values in effects.items():
        text += toml_table("[[effects]]", {"name": name} | values)
    for i, drive in enumerate(trials):
        text += toml_table("[[trials]]", {"file": f"s{i:02d}.csv"} | drive)
    return text


def slider(*words: object) -> None:
    """Runs a `slider` command, whose output goes to the terminal."""
    print("slider", *words, flush=True)
    subprocess.run(command(*words), check=True)


@contextmanager
def hidden_rig(folder: Path) -> Iterator[tuple[str, Path]]:
    """Runs the rig with the hidden effects. Yields the rig's port and rig file."""
    truth = folder / "truth.toml"
    truth.write_text(experiment(TRUE, HIDDEN, BEGIN))
    with simulated(truth, folder, "--noise", 300, "--force-noise", 3e-3) as served:
        yield served


def report_summary(path: Path) -> dict[str, Any]:
    """Returns a report's verdict and effects, and whether the intervals contain the true values."""
    report = json.loads(path.read_text())
    found = {effect["name"]: effect for effect in report["effects"]}
    intervals = dict(report["parameters"])
    truth = dict(TRUE)
    for name, values in HIDDEN.items():
        if name in found:
            intervals |= found[name]["parameters"]
            truth |= values
    return {
        "verdict": report["verdict"],
        "effects": {name: effect["class"] for name, effect in found.items()},
        "hold": {
            key: intervals[key]["low"] <= x <= intervals[key]["high"] for key, x in truth.items()
        },
        "values": {key: intervals[key]["value"] for key in truth},
    }


def first_of(sweep: Path, count: int, folder: Path) -> Path:
    """Writes an experiment with the sweep's first trials and returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "experiment.toml"
    path.write_text(experiment(GIVEN, {}, SWEEP[:count]))
    for i in range(count):
        for name in (f"s{i:02d}.csv", f"s{i:02d}.played.csv"):
            (folder / name).write_bytes((sweep / name).read_bytes())
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder for the results")
    counts = "numbers of the sweep's trials for `slider close-loop` (default: 4 5 12)"
    add("--counts", type=int, nargs="*", default=[4, 5, 12], help=counts)
    arguments = parser.parse_args()
    out = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    (out / "given.toml").write_text(experiment(GIVEN, {}, BEGIN))
    (out / "sweep.toml").write_text(experiment(GIVEN, {}, SWEEP))
    results: dict[str, Any] = {}
    if not (out / "loop" / "report.json").exists():
        with hidden_rig(out) as (port, rig):
            start = time.monotonic()
            slider("rig", "loop", out / "given.toml", "--port", port, "--rig", rig,
                   "--out", out / "loop", "--budget", BUDGET, *RANGES)  # fmt: skip
            results["loop_seconds"] = time.monotonic() - start
    if not (out / "sweep" / f"s{len(SWEEP) - 1:02d}.csv").exists():
        with hidden_rig(out) as (port, rig):
            slider("rig", "run", out / "sweep.toml", "--port", port, "--rig", rig,
                   "--out", out / "sweep")  # fmt: skip
    report = json.loads((out / "loop" / "report.json").read_text())
    results["loop"] = report_summary(out / "loop" / "report.json") | {
        "trials": [x["trials"] for x in report["rounds"]][-1],
        "rounds": [x["said"] for x in report["rounds"]],
        "settled": report["settled"],
    }
    for count in arguments.counts:
        folder = out / f"first_{count:02d}"
        if not (folder / "out" / "report.json").exists():
            slider("close-loop", first_of(out / "sweep", count, folder), "--out", folder / "out")
        results[f"sweep of {count}"] = report_summary(folder / "out" / "report.json")
    print(json.dumps(results, indent=2))
    (out / "results.json").write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
