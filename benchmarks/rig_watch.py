"""`slider rig watch` beside a sound simulated rig, in real time, and then one whose chamber leaks.

    python benchmarks/rig_watch.py [SECONDS] [--experiment FILE] [--leak RATE]

The rig is a process of its own (`slider rig simulate`: pseudo-terminal and UDP) on the same cores.
It is sound for so many seconds of watching (600); then its front left chamber leaks at the rate
given [1/s], and an alarm should end the watch. Told are how late the model is, the share of the
time that it computes, alarms while the robot was sound, and how long after the leak its alarm came.
Bars: 50 ms, none, 2 s.
"""

import argparse
import json
import platform
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from rig_process import command, simulated

START = 25.0
"""[s] of the rig's clock by which the watch has begun, its model compiled."""
SLACK = 40.0
"""[s] after which a watch that no alarm ended ends."""
SETTLED = 3.0
"""[s] of the watch that do not count: its first blocks wait for the clocks."""
BLOCK = 0.02
"""[s] of readings in a block."""
ROOT = Path(__file__).resolve().parent.parent


def measure(seconds: float, experiment: Path, rate: float, folder: Path) -> dict[str, object]:
    """A watch of a robot that is sound for so many seconds, and leaks then."""
    leak, out = seconds + START, folder / "watch"
    fault = ("--inject", f"leak_front_left={rate:g}@{leak:g}")
    with simulated(experiment, folder, *fault) as (port, rig):
        done = subprocess.run(
            command("rig", "watch", experiment, "--port", port, "--rig", rig,
                    "--out", out, "--seconds", leak + SLACK)
        )  # fmt: skip
    told = json.loads((out / "watch.json").read_text())
    rows = np.genfromtxt(out / "watch.csv", delimiter=",", names=True)
    t_0, counted = told["t_0_device_s"], rows["t_s"] > SETTLED
    alarms = [(t_0 + x["t_s"] - leak, x["said"]) for x in told["alarms"]]
    late = 1e3 * rows["lag_s"][counted]
    return {
        "experiment": str(experiment),
        "exit_code": done.returncode,
        "sound_seconds": min(leak - t_0, float(rows["t_s"][-1])),
        "blocks": len(rows),
        "lost": told["lost"],
        "false_alarms": [said for after, said in alarms if after < 0.0],
        "alarm": next(({"after_s": t, "said": said} for t, said in alarms if t >= 0.0), None),
        "lag_ms": {f"{q:g} %": float(np.percentile(late, q)) for q in (50, 95, 99, 99.9, 100)},
        "computing": float(np.mean(rows["compute_s"][counted])) / BLOCK,
        "versions": told["versions"],
        "machine": platform.platform(),
    }


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("seconds", type=float, nargs="?", default=600.0)
    asked.add_argument("--experiment", type=Path, default=ROOT / "docs" / "experiment.toml")
    asked.add_argument("--leak", type=float, default=1.2)
    given = asked.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measured = measure(given.seconds, given.experiment, given.leak, Path(folder))
    print(json.dumps(measured, indent=2))


if __name__ == "__main__":
    main()
