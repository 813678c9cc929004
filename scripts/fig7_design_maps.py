"""Computes the paper's maps (Fig. 7) of steady speed against tail length and EI, or phase.

    python scripts/fig7_design_maps.py results/fig7

The script writes fig7.png, fig7.txt (checks of the paper's statements) and fig7.json (all numbers).
An interrupted run resumes when you repeat the command.
"""

import argparse
import shutil
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np

from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, load
from slider_jax.io.files import (
    input_file,
    staged,
    tentative_folder,
    versions,
    write_json,
    write_text,
)
from slider_jax.precision import enable_float64
from slider_jax.reproduction.design_findings import StatementCheck, findings
from slider_jax.reproduction.design_maps import MARKED, Map, best_phase, best_stiffness
from slider_jax.reproduction.design_maps_report import SHOWN_LENGTHS, plot_design_maps
from slider_jax.sweep.sweep import Axis, Sweep, run_sweep

SWIMMER = Path(__file__).resolve().parent.parent / "docs" / "swimmer.toml"
STIFFNESS = (3e-5, 0.038)
"""Assumed smallest and largest EI of the tail [N m^2]. The smallest value is the EI of the fastest
tail of 20 mm. The largest value is the EI of the body."""
STEPS_PER_STRIDE = 100
"""Number of time steps per stride. With 300 steps, speeds change by less than 0.05 %."""


def sweeps(swimmer: Experiment, points: int) -> dict[str, Sweep]:
    """Returns the sweeps of maps a and b. Each axis has `points` values and the plotted values."""
    if points < 4:
        raise InputError.value("--points", points, "4 or more, to include a negative phase")
    lengths = _with(np.linspace(SHOWN_LENGTHS[0], SHOWN_LENGTHS[-1], points), SHOWN_LENGTHS)
    axes = {
        "a": Axis("robot.EI_tail", tuple(map(float, np.geomspace(*STIFFNESS, points)))),
        "b": Axis("trials.0.phase", _with(np.linspace(-0.5, 0.5, points), MARKED)),
    }
    tail, steps = Axis("robot.tail_length", lengths), STEPS_PER_STRIDE
    return {
        name: Sweep(swimmer, (tail, axis), steps_per_stride=steps, swim=True)
        for name, axis in axes.items()
    }


def _with(values: np.ndarray, more: tuple[float, ...]) -> tuple[float, ...]:
    """Returns the sorted union of `values` and `more`."""
    return tuple(map(float, np.unique(np.round([*values, *more], 9))))


def map_of_sweep(sweep: Sweep, name: str, folder: Path) -> Map:
    """Runs a sweep and returns the map of the sweep. Finished parts are in `folder`/partial."""
    folder.mkdir(exist_ok=True)
    count = {"done": 0, "all": 0}

    def show():
        print(f"\rmap {name}: {count['done']} of {count['all']} parts", end="", file=sys.stderr)

    def begin(parts, done):
        count.update(done=done, all=parts)
        show()

    def step():
        count["done"] += 1
        show()

    table = run_sweep(sweep, folder, begin, step)
    print(file=sys.stderr)
    lengths, across = (np.array(axis.values) for axis in sweep.axes)
    return Map(lengths, across, table["speed_m_per_s"].reshape(len(lengths), len(across)))


def lines_of(found: list[StatementCheck]) -> str:
    """Returns the checks as text."""
    return "\n".join(
        f"{number}. {x.claim}: {x.verdict}\n   measured: {x.measured}\n   rule: {x.rule}"
        for number, x in enumerate(found, 1)
    )


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="OUT_DIR", help="folder for the results")
    parser.add_argument(
        "--points", type=int, default=17, metavar="N", help="values per axis (default: 17)"
    )
    parser.add_argument(
        "--swimmer", type=Path, default=SWIMMER, metavar="FILE",
        help="experiment file (default: docs/swimmer.toml)",
    )  # fmt: skip
    given = parser.parse_args(argv)
    enable_float64()
    swimmer = load(given.swimmer)
    tasks = sweeps(swimmer, given.points)
    with tentative_folder(given.folder) as out:
        parts = {name: out / f"map_{name}" for name in tasks}
        a, b = (map_of_sweep(tasks[name], name, parts[name]) for name in tasks)
    found, trial = findings(a, b), swimmer.trials[0]
    title = f"{swimmer.name}, {trial.frequency:g} Hz, {1e-3 * trial.amplitude:g} kPa"
    slices = f"a, c: phase {trial.phase:g}; b, d: EI {1e3 * swimmer.robot.EI_tail:g} mN m²"
    missing = sum(int(np.isnan(x.speed).sum()) for x in (a, b))
    text = f"{title}\n{slices}\n{missing} points without a steady speed\n\n{lines_of(found)}\n"
    record = {
        "input": input_file(given.swimmer),
        "settings": {name: task.settings() for name, task in tasks.items()},
        "points_without_a_steady_speed": missing,
        "map_a": {
            "tail_length_m": a.lengths,
            "EI_tail_N_m2": a.across,
            "speed_m_per_s": a.speed,
            "best": [p._asdict() for p in best_stiffness(a)],
        },
        "map_b": {
            "tail_length_m": b.lengths,
            "phase": b.across,
            "speed_m_per_s": b.speed,
            "best": [p._asdict() for p in best_phase(b)],
        },
        "findings": [x._asdict() | {"verdict": x.verdict} for x in found],
        "seed": None,
        "versions": versions(),
    }
    with staged(out) as stage:
        plot_design_maps(a, b, f"{title}; {slices}", stage / "fig7.png")
        write_json(stage / "fig7.json", record)
        write_text(stage / "fig7.txt", text)
    for folder in parts.values():
        shutil.rmtree(folder / "partial", ignore_errors=True)
        with suppress(OSError):  # the folder contains other files
            folder.rmdir()
    print(text, end="")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except InputError as error:
        print(f"fig7_design_maps: {error}", file=sys.stderr)
        sys.exit(2)
