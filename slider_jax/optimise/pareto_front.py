"""Computes the Pareto front of designs that swim and climb efficiently with one tail."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slider_jax.errors import InputError, SolverError
from slider_jax.io.files import write_json
from slider_jax.optimise.loop import (
    CHECKPOINT,
    PLAN,
    Generation,
    refuse_other_settings,
    refuse_without,
    run_optimiser,
    settings_of,
)
from slider_jax.optimise.optimiser import cma_es, make_optimiser
from slider_jax.optimise.population import barrier, is_first
from slider_jax.optimise.two_tasks import CLIMB, NAMES, SWIM, TAIL, TaskEfficiencies, TwoTasks, eta

NEAR = 0.06
"""Initial standard deviation of an optimisation that starts from a known design, as a fraction of
the bounds' width."""
BLENDS = 5
"""Number of starting designs whose tails are between the best tails of the two tasks."""


class FrontPoint(NamedTuple):
    """The best design for one beta, which is the weight of swimming."""

    beta: float
    eta: float
    efficiencies: np.ndarray
    """Efficiencies E_swim of swimming and E_climb of climbing, shape (2,) [-]."""
    design: np.ndarray
    """Variables (11,) in the unit box, in the order of `NAMES`."""


class Front(NamedTuple):
    """Result of a multimodal optimisation."""

    points: list[FrontPoint]
    """Points of the front, by increasing beta."""
    only: np.ndarray
    """E_swim,only and E_climb,only (2,): maxima over `alone` and over all compared designs."""
    alone: np.ndarray
    """Best E_swim and E_climb (2,), each from the optimisations of this task alone."""
    evaluations: dict[str, int]
    """Number of evaluations of each optimisation, by its name."""


class FrontEffort(NamedTuple):
    """Algorithm, population size, generations and seed of a front's optimisations."""

    algorithm: str = "genetic"
    population: int = 112
    generations: int = 30
    seed: int = 0

    @property
    def between(self) -> tuple[int, int]:
        """Population size and generations of an optimisation that starts from a known design."""
        return max(6, self.population // 4), max(1, self.generations // 2)


@dataclass
class FrontSearches:
    """The optimisations of a front. Each optimisation writes a checkpoint to its own folder."""

    modes: TwoTasks
    effort: FrontEffort
    folder: Path
    on_generation: Callable[[str, Generation, float], None]

    def __post_init__(self) -> None:
        self.both, self.evaluations = TaskEfficiencies(self.modes, self.folder), dict[str, int]()

    def optimise(
        self,
        name: str,
        free: tuple[int, ...],
        base: np.ndarray,
        beta: float,
        only: np.ndarray,
        near: bool = True,
    ) -> tuple[np.ndarray, float]:
        """Returns (design, eta) of the best design.

        Only variables with the indices `free` vary. All other variables keep the values of `base`.
        If `near`, the optimisation starts from `base`, otherwise in the whole unit box.
        """
        effort, columns = self.effort, list(free)
        population, generations = effort.population, effort.generations
        if near:
            population, generations = effort.between
            algorithm = cma_es(population, len(free), base[columns], NEAR)
        else:
            algorithm = make_optimiser(effort.algorithm, population, len(free))

        def put(part: np.ndarray) -> np.ndarray:
            designs = np.tile(base, (len(part), 1))
            designs[:, columns] = part
            return designs

        def evaluate(part: np.ndarray, gradients: bool) -> tuple[np.ndarray, None]:
            return eta(beta, self.both(put(part), beta > 0.0, beta < 1.0), only), None

        start = {"free": [NAMES[i] for i in free], "base": base.tolist(), "near": near,
                 "beta": beta, "only": only.tolist()}  # fmt: skip
        task = self.modes.settings() | {"start": start}
        settings = settings_of(algorithm, population, effort.seed, task)
        place = self.folder / name
        if is_first():
            place.mkdir(exist_ok=True)
        found = run_optimiser(
            algorithm, evaluate, generations, effort.seed, settings, place, True,
            is_first(), lambda generation, seconds: self.on_generation(name, generation, seconds),
        )  # fmt: skip
        if not np.isfinite(found.score):
            raise SolverError(
                f"{name}: all {found.history[-1].evaluations} designs fail: a time step does not "
                "converge, no steady speed is found, or the error of the climb's energy balance is "
                "too large; increase --population, or change the bounds"
            )
        self.evaluations[name] = found.history[-1].evaluations
        return put(found.best[None])[0], found.score

    def alone(self, task: str, part: tuple[int, ...], beta: float) -> tuple[np.ndarray, float]:
        """Returns (design, eta) of the best design for one task.

        The best design of a first optimisation is the start of a second optimisation.
        """
        free, one = part + TAIL, np.ones(2)
        first = self.optimise(f"{task}_only", free, np.full(len(NAMES), 0.5), beta, one, near=False)
        again = self.optimise(f"{task}_only_again", free, first[0], beta, one)
        return max(first, again, key=lambda result: result[1])


def search_front(
    modes: TwoTasks,
    betas: int,
    effort: FrontEffort,
    folder: Path,
    resume: bool = False,
    on_generation: Callable[[str, Generation, float], None] = lambda *progress: None,
) -> Front:
    """Returns the best designs for `betas` evenly spaced values of beta from 0 to 1.

    1. Optimise each task alone.
    2. Optimise each task's drive for the other task's tail.
    3. Optimise both tasks for each beta, from swimming to climbing. Each optimisation starts from
       the best design that is known for this beta.
    4. Select the best of all designs for each beta.

    With `resume`, an interrupted optimisation continues. Raises `InputError` if `folder` contains
    an optimisation and `resume` is false, or if this optimisation has other settings.
    """
    _begin(folder, {"betas": betas, **effort._asdict(), **modes.settings()}, resume)
    searches = FrontSearches(modes, effort, folder, on_generation)
    swims, E_swim = searches.alone("swim", SWIM, 1.0)
    climbs, E_climb = searches.alone("climb", CLIMB, 0.0)
    for name, found in (("swim", E_swim), ("climb", E_climb)):
        if found <= 0.0:
            raise SolverError(
                f"{name}_only: no design moves forward; the best efficiency is {found:.3g}; "
                "increase --population, or change the bounds"
            )
    only = alone = np.array([E_swim, E_climb])
    known = list[np.ndarray]()
    for share in np.linspace(0.0, 1.0, BLENDS + 2):  # 0: swimmer's tail, 1: climber's tail
        design = swims.copy()
        design[list(CLIMB)] = climbs[list(CLIMB)]
        design[list(TAIL)] += share * (climbs - swims)[list(TAIL)]
        known.append(design)
    ends = (("climb_with_swimmers_tail", CLIMB, known[0], 0.0),
            ("swim_with_climbers_tail", SWIM, known[-1], 1.0))  # fmt: skip
    known += [searches.optimise(name, part, base, beta, only)[0] for name, part, base, beta in ends]
    efficiencies = searches.both(np.stack(known), True, True)
    values, free = np.linspace(0.0, 1.0, betas), tuple(range(len(NAMES)))
    for beta in values[-2:0:-1].tolist():
        begin = known[_best(beta, known, efficiencies, only)[1]]
        known.append(searches.optimise(f"beta_{beta:.3f}", free, begin, beta, only)[0])
        new = searches.both(known[-1][None], True, True)
        efficiencies = np.concatenate([efficiencies, new])
    only, points = np.fmax(alone, np.nanmax(efficiencies, axis=0)), []
    for beta in values.tolist():
        score, i = _best(beta, known, efficiencies, only)
        points.append(FrontPoint(beta, score, efficiencies[i], known[i]))
    return Front(points, only, alone, searches.evaluations)


def _begin(folder: Path, settings: dict[str, Any], resume: bool) -> None:
    """Writes the settings of a new optimisation, or checks the settings of a resumed one."""
    file, settings = folder / PLAN, json.loads(json.dumps(settings))
    if file.exists():
        refuse_without(resume, file)
        try:
            saved = json.loads(file.read_text())
        except (OSError, ValueError):
            saved = None
        if not isinstance(saved, dict) or saved.keys() != settings.keys():
            raise InputError(
                f"{file}: the file is damaged or was not written by this program; restore it from "
                "a copy, or give another folder"
            )
        refuse_other_settings(settings, saved, file)
    elif any(folder.glob(f"**/{CHECKPOINT}")):
        raise InputError(
            f"{folder}: this folder holds checkpoints of another optimisation; give another folder"
        )
    barrier("settings are checked")
    if is_first():
        folder.mkdir(parents=True, exist_ok=True)
        write_json(file, settings)


def _best(
    beta: float, known: list[np.ndarray], efficiencies: np.ndarray, only: np.ndarray
) -> tuple[float, int]:
    """Returns (largest eta, index). If eta is equal, the sum of relative efficiencies decides."""
    scores = eta(beta, efficiencies, only)
    other = np.nan_to_num((efficiencies / only).sum(axis=1), nan=-1.0)
    scores = np.where(np.isfinite(scores), scores, -np.inf)
    i = int(np.argmax(scores + 1e-6 * other))
    return float(scores[i]), i


def dominated(points: list[FrontPoint]) -> list[float]:
    """Returns the betas of the points that a neighbour dominates.

    A neighbour dominates a point if one of its efficiencies is larger and none is smaller.
    """
    return [
        point.beta
        for i, point in enumerate(points)
        for more in (x.efficiencies - point.efficiencies for x in points[max(0, i - 1) : i + 2])
        if np.all(more >= 0.0) and np.any(more > 0.0)
    ]
