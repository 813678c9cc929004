"""Measures the time and the memory of `slider close-loop` on simulated tanks.

    python benchmarks/close_loop_time.py --out DIR            ten tanks of eight trials, 22.5 s
    python benchmarks/close_loop_time.py --out DIR --long     longer trials, and more of them; the
                                                              plot is DIR/growth.png

The ten tanks have different missing effects. The first run of the command on a computer compiles
its programs; the benchmark therefore runs the first tank twice, and reports both runs. The computer
should be idle otherwise. Tanks with a result in DIR/times.json are not run again.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Container
from pathlib import Path
from typing import Any

from record import write_record

from calibration.measurements.synthetic import START, Truth, random_trials, write_tank
from slider_jax import enable_float64
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.files import write_json

SECONDS = (5.0, 4.0, 3.0, 2.5, 2.0, 2.0, 2.0, 2.0)
CAUSES: dict[str, dict[str, dict[str, float]]] = {
    "none": {},
    "leakage": {"leakage": {"leak": 1.2}},
    "tail_stiffness": {"tail_stiffness": {"x": 0.24}},
    "force_drift": {"force_drift": {"thrust": 0.006}},
    "clamp_compliance": {"clamp_compliance": {"compliance": 0.4}},
    "tank_current": {"tank_current": {"U_x": 0.06}},
    "line_lag": {"line_lag": {"tau": 0.02}},
    "tail_drag": {"tail_drag": {"C": 0.9}},
    "regulator_gain": {"regulator_gain": {"gain": 0.06}},
    "valve_delay_and_friction": {
        "valve_delay": {"delay": 0.01},
        "tangential_friction": {"C_t": 0.03},
    },
}
LONG: dict[str, tuple[float, ...]] = {
    "8 trials of 60 s": (60.0,) * 8,
    "50 trials of 5 s": (5.0,) * 50,
    "4 trials of 5 s and 1 of 600 s": (5.0, 5.0, 600.0, 5.0, 5.0),
    "8 trials of 2 to 5 s": SECONDS,
}


def write_tanks(out: Path, long: bool, only: Container[str] | None = None) -> dict[str, Path]:
    """Returns the experiment file of each tank in `only`, or of all; simulates missing tanks."""
    tanks: dict[str, tuple[dict[str, dict[str, float]], tuple[float, ...], int]] = {}
    if long:
        skin = {"tangential_friction": {"C_t": 0.03}}
        tanks = {name: (skin, seconds, 3) for name, seconds in LONG.items()}
    else:
        tanks = {n: (cause, SECONDS, 20 + i) for i, (n, cause) in enumerate(CAUSES.items())}
    found = {}
    for i, (name, (effects, seconds, seed)) in enumerate(tanks.items()):
        if only and name not in only:
            continue
        folder = out / name.replace(" ", "_")
        trials = [
            trial | {"duration": duration}
            for trial, duration in zip(random_trials(seed, len(seconds)), seconds, strict=True)
        ]
        base = START | {"C_d": 2.5 + 0.1 * i, "m_a": 0.6 + 0.02 * i}
        if not (folder / trials[-1]["file"]).exists():
            print(f"simulating the tank {name}", file=sys.stderr)
            write_tank(folder, Truth(base, effects), trials, i)
        found[name] = folder / "experiment.toml"
    return found


def run(experiment: Path, out: Path) -> dict[str, Any]:
    """Returns wall-clock time, CPU time, peak memory and verdict of one run of the command."""
    command = [sys.executable, "-m", "slider_jax.cli.main", "close-loop", str(experiment)]
    start = time.perf_counter()
    process = subprocess.Popen(
        [*command, "--out", str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(command)}: failed with status {status}")
    report = json.loads((out / "report.json").read_text())
    return {
        "wall_s": time.perf_counter() - start,
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "peak_GB": 1024.0 * usage.ru_maxrss / 1e9,
        "verdict": report["verdict"],
        "effects": {x["name"]: x["class"] for x in report["effects"]},
    }


def draw_growth(times: dict[str, dict[str, Any]], path: Path) -> None:
    """Writes a plot of CPU time and peak memory against the duration of all trials."""
    figure, axes = new_figure(1, 2, figsize=(9.0, 3.6), sharex=True)
    quantities = {"cpu_s": "CPU time (s)", "peak_GB": "peak memory (GB)"}
    for ax, (key, label) in zip(axes, quantities.items(), strict=True):
        for name, marker in zip(LONG, "osD^", strict=True):
            if name in times:
                ax.plot(sum(LONG[name]), times[name][key], marker, label=name)
        ax.set(xlabel="duration of all trials (s)", ylabel=label, xlim=(0, None), ylim=(0, None))
        ax.grid(alpha=0.3)
    handles = axes[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=2, fontsize=8)
    save_figure(figure, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--long", action="store_true")
    parser.add_argument("--only", nargs="*", help="names of tanks (default: all)")
    given = parser.parse_args()
    enable_float64()
    given.out.mkdir(parents=True, exist_ok=True)
    table = given.out / "times.json"
    times: dict[str, dict[str, Any]] = json.loads(table.read_text()) if table.exists() else {}
    runs = [*write_tanks(given.out, given.long, given.only).items()]
    for name, path in ([("first run", runs[0][1])] if not given.long else []) + runs:
        if name in times:
            continue
        times[name] = run(path, path.parent / f"loop_{name.replace(' ', '_')}")
        write_json(table, times)
    kind = "trials" if given.long else "tanks"
    write_record(given.out / "record.json", {kind: times})
    if given.long:
        draw_growth(times, given.out / "growth.png")
    for name, x in times.items():
        named = ", ".join(x["effects"]) or "none"
        print(
            f"{name:32} {x['wall_s']:6.0f} s  {x['cpu_s']:6.0f} CPU s  {x['peak_GB']:.2f} GB  "
            f"{x['verdict']}: {named}"
        )


if __name__ == "__main__":
    main()
