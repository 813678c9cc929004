"""Measures what processes exchange if they share the generations of an optimisation by a folder.

    python benchmarks/sharing.py --out benchmarks/results/sharing.json

A part of a generation takes a fixed time in this benchmark, instead of a simulation. The benchmark
reports files and bytes of a generation, and the time of a generation beyond its computing time.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from record import ROOT, write_record

GENERATIONS, SECONDS = 10, 0.05
"""Number of generations, and computing time [s] of a part."""
CASES = {
    "112 individuals": (112, 16),
    "1600 individuals": (1600, 16),
    "12800 individuals": (12800, 128),
}
"""Individuals, and individuals in a part (8 for each core)."""


def run(folder: Path, population: int, rows: int, begin: float) -> None:
    """Evaluates all generations from the time `begin` [s] on, and prints their mean time [s]."""
    from slider_jax.optimise.population import SharedEvaluation

    class Sleeping:
        def __init__(self) -> None:
            self.rows = rows

        def __call__(self, part: np.ndarray) -> np.ndarray:
            time.sleep(SECONDS)
            return part.sum(axis=1)

    evaluate = SharedEvaluation(Sleeping(), folder, {})  # type: ignore[arg-type]
    time.sleep(max(0.0, begin - time.time()))
    start = time.perf_counter()
    for number in range(GENERATIONS):
        evaluate(np.random.default_rng(number).uniform(size=(population, 6)))
    print((time.perf_counter() - start) / GENERATIONS)


def measured(folder: Path, population: int, rows: int, processes: int) -> dict[str, float]:
    words = [sys.executable, __file__, "--run", str(folder), str(population), str(rows)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    begin = str(time.time() + 15.0)
    runs = [
        subprocess.Popen([*words, begin], stdout=subprocess.PIPE, text=True, env=environment)
        for _ in range(processes)
    ]
    seconds = max(float(run.communicate()[0]) for run in runs)
    files = [x for x in folder.rglob("*") if x.is_file()]
    parts = -(-population // rows)
    return {
        "parts": parts,
        "files": len(files) / GENERATIONS,
        "bytes_of_file": max(x.stat().st_size for x in files),
        "bytes_written": sum(x.stat().st_size for x in files) / GENERATIONS,
        "computing_s": SECONDS * -(-parts // processes),
        "generation_s": round(seconds, 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="file for the record")
    parser.add_argument("--run", nargs=4, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.run:
        folder, population, rows, begin = given.run
        run(Path(folder), int(population), int(rows), float(begin))
        return
    figures: dict[str, dict] = {}
    with tempfile.TemporaryDirectory() as work:
        for name, (population, rows) in CASES.items():
            for processes in (1, 2):
                folder = Path(work) / f"{name}_{processes}"
                found = measured(folder, population, rows, processes)
                figures.setdefault(name, {})[str(processes)] = found
                print(name, processes, json.dumps(found), flush=True)
    write_record(given.out, figures)


if __name__ == "__main__":
    main()
