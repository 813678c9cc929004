"""Measures the first call of everyday commands: cold, in a second process, and after warm-up.

    python benchmarks/start_up.py --out benchmarks/results/start_up.json

The first two columns share a cache folder, and the third has its own. Both are empty at the start.
A time is the wall-clock time of a process, and its CPU time in brackets, which depends less on
other programs.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from record import ROOT, write_record

EXPERIMENT = "docs/experiment.toml"
FIRST = """
import sys; sys.path.insert(0, "benchmarks")
import jax
from slider_jax.programs import compiled_once, kept_programs
from cases import model, run
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
with kept_programs():
    jax.block_until_ready(compiled_once(run)(model()))
"""
"""One simulation of the benchmark's robot, in a process that keeps programs as commands do."""


def timed(words: list[str], cache: Path) -> dict[str, float]:
    """Returns the times [s] of a command with the cache folder `cache`."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "PYTHONPATH": str(ROOT)}
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(words, env=environment, cwd=ROOT, check=True, capture_output=True)
    after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - start
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall_s": round(wall, 2), "cpu_s": round(cpu, 2)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="file for the record")
    out = parser.parse_args().out.resolve()
    slider = [sys.executable, "-m", "slider_jax.cli.main"]
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        cold, warm = work / "cold", work / "warm"
        tank = [sys.executable, "scripts/make_tank.py", str(work / "tank"), "--seed", "3"]
        timed(tank, work / "other")
        calls = {
            "simulate": ["simulate", EXPERIMENT],
            "swim": ["swim"],
            "climb": ["climb"],
            "calibrate": ["calibrate", str(work / "tank" / "experiment.toml")],
            "demo": ["demo"],
            "close-loop": ["close-loop", str(work / "tank" / "experiment.toml")],
        }
        figures: dict = {"help": timed([*slider, "--help"], cold), "calls": {}}
        one = [sys.executable, "-c", FIRST, str(work / "one")]
        figures["one_simulation"] = {"cold": timed(one, cold), "second": timed(one, cold)}
        print(json.dumps(figures), flush=True)
        figures["warm_up"] = timed([*slider, "warm-up"], warm)
        figures["warm_up_again"] = timed([*slider, "warm-up"], warm)
        figures["warm_up_of_experiment"] = timed(
            [*slider, "warm-up", EXPERIMENT, "--parts", "simulate"], warm
        )
        figures["warm_up_of_close_loop"] = timed(
            [*slider, "warm-up", "--parts", "close-loop"], warm
        )
        print(json.dumps(figures), flush=True)
        for name, call in calls.items():
            command = [*slider, *call, "--out", str(work / name)]
            figures["calls"][name] = {
                "cold": timed(command, cold),
                "second": timed(command, cold),
                "after_warm_up": timed(command, warm),
            }
            print(name, json.dumps(figures["calls"][name]), flush=True)
    write_record(out, figures)


if __name__ == "__main__":
    main()
