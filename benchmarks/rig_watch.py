"""Measures `slider rig watch` in real time with a simulated rig whose chamber starts to leak.

    python benchmarks/rig_watch.py [SECONDS] [--experiment FILE] [--leak RATE]

The rig (`slider rig simulate`) is a separate process on the same cores. The rig has no fault for
SECONDS (default: 600). Then the front left chamber leaks until an alarm ends `slider rig watch`.
The benchmark reports:

- the model's delay without a fault (limit: 50 ms for 99 of 100 blocks);
- the fraction of the time in which the model computes;
- the number of false alarms (limit: 0);
- the time from the start of the leak to the alarm (limit: 2 s).
"""

import argparse
import json
import os
import platform
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rig_process import command, simulated

from calibration.twin.twin import TwinSettings

START = 25.0
"""Time [s] on the rig's clock at which `slider rig watch` has compiled the model and has begun."""
WAIT_AFTER_LEAK = 40.0
"""Time [s] after the start of the leak, after which the benchmark stops waiting for an alarm."""
START_UP = 3.0
"""Initial time [s] that is omitted, because the first blocks wait for the clock estimates."""
MIN_SECONDS = 20.0
"""Shortest time [s] without a fault that is long enough to learn the bands."""
BLOCK = TwinSettings().samples / TwinSettings().rate
"""Duration [s] of a block of readings."""
ROOT = Path(__file__).resolve().parent.parent


def measure(seconds: float, experiment: Path, rate: float, folder: Path) -> dict[str, Any]:
    """Runs `slider rig watch` on a robot that leaks after `seconds`. Returns the measured values.

    Raises `RuntimeError` if the command fails.
    """
    leak, out = seconds + START, folder / "watch"
    fault = ("--inject", f"leak_front_left={rate:g}@{leak:g}")
    with simulated(experiment, folder, *fault) as (port, rig):
        # Without a terminal, `slider rig watch` ends at the first alarm.
        done = subprocess.run(
            command("rig", "watch", experiment, "--port", port, "--rig", rig,
                    "--out", out, "--seconds", leak + WAIT_AFTER_LEAK),
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    if done.returncode not in (0, 1):
        raise RuntimeError(f"slider rig watch ended with {done.returncode}: {done.stderr[-2000:]}")
    record = json.loads((out / "watch.json").read_text())
    rows = np.genfromtxt(out / "watch.csv", delimiter=",", names=True)
    t_leak = leak - record["t_0_device_s"]
    sound = rows[(rows["t_s"] > START_UP) & (rows["t_s"] < t_leak)]
    late = 1e3 * sound["lag_s"]
    alarms = [{"after_s": x["t_s"] - t_leak, "said": x["said"]} for x in record["alarms"]]
    return {
        "experiment": str(experiment),
        "sound_s": float(sound["t_s"][-1]),
        "blocks": len(sound),
        "lost": record["lost"],
        "lag_ms": {f"{q:g} %": float(np.percentile(late, q)) for q in (50, 95, 99, 99.9, 100)},
        "computing": float(np.mean(sound["compute_s"])) / BLOCK,
        "false_alarms": [x for x in alarms if x["after_s"] < 0.0],
        "leak_1_per_s": rate,
        "alarm": next((x for x in alarms if x["after_s"] >= 0.0), None),
        "reached_the_leak": bool(rows["t_s"][-1] > t_leak),
        "versions": record["versions"],
        "machine": f"{platform.platform()}, {os.cpu_count()} cores",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("seconds", type=float, nargs="?", default=600.0,
        help="time without a fault, in s (default: 600)")  # fmt: skip
    add("--experiment", type=Path, default=ROOT / "docs" / "experiment.toml",
        help="experiment file (default: docs/experiment.toml)")  # fmt: skip
    add("--leak", type=float, default=1.2, help="rate of the leak, in 1/s (default: 1.2)")
    arguments = parser.parse_args()
    if not arguments.seconds >= MIN_SECONDS:
        parser.error(f"SECONDS {arguments.seconds:g}: allowed {MIN_SECONDS:g} or more")
    with tempfile.TemporaryDirectory() as folder:
        measured = measure(arguments.seconds, arguments.experiment, arguments.leak, Path(folder))
    print(json.dumps(measured, indent=2))


if __name__ == "__main__":
    main()
