"""`slider rig watch` beside a sound simulated rig, in real time, and then one whose chamber leaks.

    python benchmarks/rig_watch.py [SECONDS] [--experiment FILE] [--leak RATE]

The rig is a process of its own (`slider rig simulate`: pseudo-terminal and UDP) on the same cores.
It is sound for so many seconds of watching (600); then its front left chamber leaks at the rate
given [1/s], until an alarm ends the watch. Told are, of the sound robot, how late the model is
(bar: 50 ms for 99 of 100 blocks), the share of the time that it computes, and its alarms (none);
and how long after the leak its alarm came (2 s).
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
"""[s] of the rig's clock by which a watch has begun, its model compiled."""
PATIENCE = 40.0
"""[s] of the leak after which a watch that no alarm ended ends."""
SETTLED = 3.0
"""[s] of the watch that do not count: its first blocks wait for the clocks."""
LEAST = 20.0
"""[s] of a sound robot: shorter, the bands may not be learned."""
BLOCK = TwinSettings().samples / TwinSettings().rate
"""[s] of readings in a block."""
ROOT = Path(__file__).resolve().parent.parent


def measure(seconds: float, experiment: Path, rate: float, folder: Path) -> dict[str, Any]:
    """A watch of a robot that is sound for so many seconds, and leaks then.

    Raises `RuntimeError` where it did not run to its end.
    """
    leak, out = seconds + START, folder / "watch"
    fault = ("--inject", f"leak_front_left={rate:g}@{leak:g}")
    with simulated(experiment, folder, *fault) as (port, rig):
        # Without a terminal: on one it goes on after an alarm.
        done = subprocess.run(
            command("rig", "watch", experiment, "--port", port, "--rig", rig,
                    "--out", out, "--seconds", leak + PATIENCE),
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    if done.returncode not in (0, 1):
        raise RuntimeError(f"slider rig watch ended with {done.returncode}: {done.stderr[-2000:]}")
    told = json.loads((out / "watch.json").read_text())
    rows = np.genfromtxt(out / "watch.csv", delimiter=",", names=True)
    t_leak = leak - told["t_0_device_s"]
    sound = rows[(rows["t_s"] > SETTLED) & (rows["t_s"] < t_leak)]
    late = 1e3 * sound["lag_s"]
    alarms = [{"after_s": x["t_s"] - t_leak, "said": x["said"]} for x in told["alarms"]]
    return {
        "experiment": str(experiment),
        "sound_s": float(sound["t_s"][-1]),
        "blocks": len(sound),
        "lost": told["lost"],
        "lag_ms": {f"{q:g} %": float(np.percentile(late, q)) for q in (50, 95, 99, 99.9, 100)},
        "computing": float(np.mean(sound["compute_s"])) / BLOCK,
        "false_alarms": [x for x in alarms if x["after_s"] < 0.0],
        "leak_1_per_s": rate,
        "alarm": next((x for x in alarms if x["after_s"] >= 0.0), None),
        "reached_the_leak": bool(rows["t_s"][-1] > t_leak),
        "versions": told["versions"],
        "machine": f"{platform.platform()}, {os.cpu_count()} cores",
    }


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument(
        "seconds", type=float, nargs="?", default=600.0, help="sound [s]: %(default)s"
    )
    asked.add_argument("--experiment", type=Path, default=ROOT / "docs" / "experiment.toml")
    asked.add_argument("--leak", type=float, default=1.2, help="[1/s]: %(default)s")
    given = asked.parse_args()
    if not given.seconds >= LEAST:
        asked.error(f"{given.seconds:g} s; allowed {LEAST:g} or more, for the bands to be learned")
    with tempfile.TemporaryDirectory() as folder:
        measured = measure(given.seconds, given.experiment, given.leak, Path(folder))
    print(json.dumps(measured, indent=2))


if __name__ == "__main__":
    main()
