"""Simulates everything that the table of the paper's statements and its figures need."""

import hashlib
import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from slider_jax.beam.parameters import SLIDER
from slider_jax.io.files import write_json
from slider_jax.optimise.design_space import VARIABLES, GaitBounds
from slider_jax.optimise.loop import Generation, run_optimiser, settings_of
from slider_jax.optimise.optimiser import genetic
from slider_jax.optimise.population import Evaluation
from slider_jax.reproduction.design_maps import MARKED, Map
from slider_jax.statements.assumptions import RANGES, Assumptions, from_unit, to_unit
from slider_jax.statements.joint_fit import Simulator
from slider_jax.statements.quantities import (
    FINE,
    MAP_FREQUENCY,
    MAP_PHASE,
    STIFF,
    thrust_of_strides,
)
from slider_jax.statements.verdicts import Evidence
from slider_jax.swimming.gait import Gait
from slider_jax.swimming.steady_state import find_steady

POPULATION, GENERATIONS, SEED = 112, 30, 0
"""Size of the paper's optimisation: 3,360 individuals in 30 generations."""
AT_ONCE = 4
"""Number of sets of assumptions in a part."""
CHANGES = 5
"""Number of values of each assumption that are tried alone."""
STRIDES = 17
"""Number of tail beats of the sweep that count, as in the paper: 20 without the first three."""
POINTS = 17
"""Number of values along each axis of a map."""
MAP_LENGTHS, MAP_EI = (0.02, 0.10), (3e-5, 0.038)
"""Ranges [m] and [N m^2] of the maps. The paper's text does not give them. The smallest EI is below
that of the fastest tail of 20 mm; the largest is the EI of the body."""

Progress = Callable[[str], None]


class RobotStudy(NamedTuple):
    """Maps and optimum of one robot."""

    over_stiffness: Map
    over_phase: Map
    optimum: Gait
    speed: float
    """Speed [m/s] at `optimum`."""


class Parts:
    """Finished parts of the investigation, in one file each, so that an interrupted run resumes."""

    def __init__(self, folder: Path, settings: dict[str, Any]):
        text = json.dumps(settings, sort_keys=True)
        self.folder = folder / f"partial-{hashlib.sha256(text.encode()).hexdigest()[:12]}"
        for old in folder.glob("partial-*"):
            if old != self.folder:
                shutil.rmtree(old)
        self.folder.mkdir(parents=True, exist_ok=True)

    def get(self, name: str, compute: Callable[[], Any]) -> Any:
        """Returns the content of a part, from its file if the file exists."""
        path = self.folder / f"{name}.json"
        if not path.exists():
            write_json(path, compute())
        return json.loads(path.read_text(encoding="utf-8"))

    def remove(self) -> None:
        """Deletes the files of all parts."""
        shutil.rmtree(self.folder)


def sweep_thrusts(robots: list[Assumptions], parts: Parts) -> np.ndarray:
    """Returns the mean thrusts [N] of 17 strides after 3 transient strides, as in the paper.

    The shape is (robots, frequencies, strides). The head is fixed.
    """

    def stride_means(row):
        model = Assumptions(*row[:-1]).head_fixed(row[-1])
        means, ok = thrust_of_strides(model, row[-1], STRIDES, FINE)
        return jnp.where(ok, means, jnp.nan)

    def compute() -> list[list[list[float]]]:
        rows = [[*x.values().values(), f] for x in robots for f in FINE.frequencies]
        means = Evaluation(stride_means)(np.array(rows))
        return means.reshape(len(robots), len(FINE.frequencies), STRIDES).tolist()

    return np.array(parts.get("thrusts", compute), float)


def evidence(
    simulate: Simulator,
    built_in: Assumptions,
    fitted: Assumptions,
    witnesses: dict[str, Assumptions],
    parts: Parts,
    progress: Progress,
) -> Evidence:
    """Simulates both robots, each change of one assumption, and the `witnesses`, with `FINE`."""
    names = list(RANGES)
    start, end = to_unit(built_in), to_unit(fitted)
    reverted = np.tile(end, (len(names), 1))
    np.fill_diagonal(reverted, start)
    changed = [
        np.where(np.arange(len(names)) == i, value, start)
        for i in range(len(names))
        for value in np.linspace(0.0, 1.0, CHANGES)
    ]
    others = [to_unit(x) for x in witnesses.values()]
    points = np.array([start, end, *reverted, *changed, *others])
    # Some changes are no changes, and some sets are the best for several statements.
    distinct, places = np.unique(points, axis=0, return_inverse=True)
    computed: list[dict[str, float]] = []
    for first in range(0, len(distinct), AT_ONCE):
        part = distinct[first : first + AT_ONCE]
        computed += parts.get(f"facts_{first}", partial(simulate, part))
        progress(f"assumptions: {len(computed)} of {len(distinct)} sets")
    computed = [{k: np.nan if v is None else v for k, v in row.items()} for row in computed]
    rows = [computed[place] for place in places]
    at = 2 + len(names)
    changes = [
        (name, from_unit(point).values()[name], row)
        for name, point, row in zip(np.repeat(names, CHANGES), changed, rows[at:], strict=False)
    ]
    found = zip(witnesses.items(), rows[at + len(changed) :], strict=True)
    return Evidence(
        rows[0],
        rows[1],
        dict(zip(names, rows[2:at], strict=True)),
        changes,
        {name: (x, row) for (name, x), row in found},
    )


class SwimSpeeds:
    """Computes the steady speed of any robot with any gait by one compiled program."""

    def __init__(self):
        def speed(row):
            assumed, gait = Assumptions(*row[: len(RANGES)]), Gait(*row[len(RANGES) :])
            found = find_steady(assumed.swimmer(gait), gait.frequency, FINE.search)
            return jnp.where(found.ok, found.speed, jnp.nan)

        self._evaluate = Evaluation(speed)

    def __call__(self, assumed: Assumptions, gaits: np.ndarray) -> np.ndarray:
        """Returns speeds (n,) [m/s] of gaits (n, 6); NaN without a steady speed."""
        own = np.tile(list(assumed.values().values()), (len(gaits), 1))
        return self._evaluate(np.concatenate([own, gaits], axis=1))


def study(
    name: str, assumed: Assumptions, speeds: SwimSpeeds, parts: Parts, progress: Progress
) -> RobotStudy:
    """Computes the maps of Fig. 7 and the optimum of the genetic algorithm for one robot."""
    lengths = np.linspace(*MAP_LENGTHS, POINTS)
    stiffness = np.unique(np.append(np.geomspace(*MAP_EI, POINTS), STIFF))
    phases = np.unique(np.append(np.linspace(-0.5, 0.5, POINTS), MARKED))
    base = Gait(MAP_FREQUENCY, assumed.pressure, assumed.pressure, MAP_PHASE,
                lengths[0], SLIDER["EI_tail"])  # fmt: skip

    def grid(field: str, values: np.ndarray) -> list[list[float]]:
        rows = [base._replace(**{"tail_length": length, field: x}) for length in lengths
                for x in values]  # fmt: skip
        found = speeds(assumed, np.array(rows, float))
        return found.reshape(len(lengths), len(values)).tolist()

    maps = []
    for field, values in (("EI_tail", stiffness), ("phase", phases)):
        progress(f"{name}: map of {field}, {len(lengths) * len(values)} swimmers")
        found = parts.get(f"map of {field}, {name}", partial(grid, field, values))
        maps.append(Map(lengths, values, np.array(found, float)))
    bounds = {k: (v.low, v.high) for k, v in VARIABLES.items()} | {"EI_tail": (1e-3, STIFF)}
    box = GaitBounds(*np.array(list(bounds.values())).T)
    optimiser = genetic(POPULATION, 6)

    def evaluate(points: np.ndarray, gradients: bool):
        return speeds(assumed, np.array([box.gait(x) for x in points], float)), None

    def show(generation: Generation, seconds: float) -> None:
        progress(
            f"{name}: generation {generation.number + 1} of {GENERATIONS}, "
            f"best {100 * generation.best:.1f} cm/s"
        )

    task = {"assumptions": assumed.values(), "bounds": bounds}
    folder = parts.folder / f"optimum of the {name}"
    folder.mkdir(exist_ok=True)
    best = run_optimiser(
        optimiser, evaluate, GENERATIONS, SEED, settings_of(optimiser, POPULATION, SEED, task),
        folder, resume=True, on_generation=show,
    )  # fmt: skip
    gait = Gait(*(float(x) for x in box.gait(best.best)))
    return RobotStudy(maps[0], maps[1], gait, best.score)
