"""The front of one tail for two tasks: the best designs from swimming alone to climbing alone."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slider_jax.errors import InputError, SolverError
from slider_jax.io.files import write_json
from slider_jax.optimise.loop import (
    CHECKPOINT,
    PLAN,
    Generation,
    differences,
    run_optimiser,
    settings_of,
)
from slider_jax.optimise.optimiser import cma_es, make_optimiser
from slider_jax.optimise.population import barrier, is_first
from slider_jax.optimise.two_tasks import CLIMB, NAMES, SWIM, TAIL, TaskEfficiencies, TwoTasks, eta

NEAR = 0.06
"""Standard deviation with which a search begins that starts from another's best."""
BLENDS = 5
"""Tails between those of the two tasks that are tried before the searches between."""


class FrontPoint(NamedTuple):
    """The best design at one beta."""

    beta: float
    eta: float
    efficiencies: np.ndarray
    """(2,) E_swim, E_climb."""
    design: np.ndarray
    """(11,) in the unit box."""


class Front(NamedTuple):
    """What a multimodal search found."""

    points: list[FrontPoint]
    """By rising beta."""
    only: np.ndarray
    """(2,) E_swim,only and E_climb,only: of the best designs for one task that any search found."""
    alone: np.ndarray
    """(2,) Of the best that the searches for one task alone found."""
    evaluations: dict[str, int]
    """Of each search, by its name."""


class FrontEffort(NamedTuple):
    """How long is searched. Searches between the tasks take a quarter of the members, and half of
    the generations."""

    algorithm: str = "genetic"
    population: int = 112
    generations: int = 30
    seed: int = 0

    @property
    def between(self) -> tuple[int, int]:
        """Members and generations of a search that begins at another's best."""
        return max(6, self.population // 4), max(1, self.generations // 2)


class FrontSearches:
    """The searches that a front is made of; each is kept in its own folder."""

    def __init__(
        self,
        modes: TwoTasks,
        effort: FrontEffort,
        folder: Path,
        said: Callable[[str, Generation, float], None],
    ):
        self.both, self.evaluations = TaskEfficiencies(modes), dict[str, int]()
        self._modes, self._effort, self._folder, self._said = modes, effort, folder, said

    def seek(
        self,
        name: str,
        free: tuple[int, ...],
        base: np.ndarray,
        beta: float,
        only: np.ndarray,
        near: bool = True,
    ) -> tuple[np.ndarray, float]:
        """(design, eta) of the best over the variables `free` of `base`; `near` it, or anywhere."""
        effort, columns = self._effort, list(free)
        members, generations = effort.population, effort.generations
        if near:
            members, generations = effort.between
            algorithm = cma_es(members, len(free), base[columns], NEAR)
        else:
            algorithm = make_optimiser(effort.algorithm, members, len(free))

        def put(part: np.ndarray) -> np.ndarray:
            designs = np.tile(base, (len(part), 1))
            designs[:, columns] = part
            return designs

        def evaluate(part: np.ndarray, gradients: bool) -> tuple[np.ndarray, None]:
            return eta(beta, self.both(put(part), beta > 0.0, beta < 1.0), only), None

        start = {"free": [NAMES[i] for i in free], "base": base.tolist(), "near": near,
                 "beta": beta, "only": only.tolist()}  # fmt: skip
        task = self._modes.settings() | {"start": start}
        settings = settings_of(algorithm, members, effort.seed, task)
        place = self._folder / name
        if is_first():
            place.mkdir(exist_ok=True)
        found = run_optimiser(
            algorithm, evaluate, generations, effort.seed, settings, place, True,
            is_first(), lambda generation, seconds: self._said(name, generation, seconds),
        )  # fmt: skip
        if not np.isfinite(found.score):
            raise SolverError(
                f"{name}: of {found.history[-1].evaluations} designs each has a step that fails, "
                "no steady speed, or a climb whose energies do not add up; give more members, or "
                "other bounds"
            )
        self.evaluations[name] = found.history[-1].evaluations
        return put(found.best[None])[0], found.score

    def alone(self, task: str, part: tuple[int, ...], beta: float) -> tuple[np.ndarray, float]:
        """The best for one task: from nothing, and from there once more."""
        free, one = part + TAIL, np.ones(2)
        first = self.seek(f"{task}_only", free, np.full(len(NAMES), 0.5), beta, one, near=False)
        again = self.seek(f"{task}_only_again", free, first[0], beta, one)
        return max(first, again, key=lambda found: found[1])


def search_front(
    modes: TwoTasks,
    betas: int,
    effort: FrontEffort,
    folder: Path,
    resume: bool = False,
    said: Callable[[str, Generation, float], None] = lambda name, generation, seconds: None,
) -> Front:
    """The best designs over `betas` evenly spread values of beta, 0 and 1 among them.

    First each task alone. Then at each end the other task's drive for the tail there; then beta by
    beta from swimming to climbing, each from the best that is known for it. In the end each beta
    takes the best of all designs found. With `resume` it goes on with the search that was stopped.
    Raises `InputError` if `folder` holds a search and there is no `resume`, or one with other
    settings; all of them count.
    """
    _begin(folder, {"betas": betas, **effort._asdict(), **modes.settings()}, resume)
    searches = FrontSearches(modes, effort, folder, said)
    swims, E_swim = searches.alone("swim", SWIM, 1.0)
    climbs, E_climb = searches.alone("climb", CLIMB, 0.0)
    for name, found in (("swim", E_swim), ("climb", E_climb)):
        if found <= 0.0:
            raise SolverError(
                f"{name}_only: no design gets ahead, the best has an efficiency of {found:.3g}; "
                "give more members, or other bounds"
            )
    only, known = np.array([E_swim, E_climb]), list[np.ndarray]()
    alone = only
    for share in np.linspace(0.0, 1.0, BLENDS + 2):  # of the climber's tail, with both best drives
        design = swims.copy()
        design[list(CLIMB)] = climbs[list(CLIMB)]
        design[list(TAIL)] += share * (climbs - swims)[list(TAIL)]
        known.append(design)
    ends = (("climb_with_swimmers_tail", CLIMB, known[0], 0.0),
            ("swim_with_climbers_tail", SWIM, known[-1], 1.0))  # fmt: skip
    known += [searches.seek(name, part, base, beta, only)[0] for name, part, base, beta in ends]
    efficiencies = searches.both(np.stack(known), True, True)
    values, free = np.linspace(0.0, 1.0, betas), tuple(range(len(NAMES)))
    for beta in values[-2:0:-1].tolist():
        begin = known[_best(beta, known, efficiencies, only)[1]]
        known.append(searches.seek(f"beta_{beta:.3f}", free, begin, beta, only)[0])
        new = searches.both(known[-1][None], True, True)
        efficiencies = np.concatenate([efficiencies, new])
    only, points = np.fmax(alone, np.nanmax(efficiencies, axis=0)), []
    for beta in values.tolist():
        score, i = _best(beta, known, efficiencies, only)
        points.append(FrontPoint(beta, score, efficiencies[i], known[i]))
    return Front(points, only, alone, searches.evaluations)


def _begin(folder: Path, settings: dict[str, Any], resume: bool) -> None:
    """Write down what is searched for, or check that it is what was begun."""
    file, settings = folder / PLAN, json.loads(json.dumps(settings))
    if file.exists():
        if not resume:
            raise InputError(
                f"{file}: a search was begun here; add --resume to go on with it, or give another "
                "folder"
            )
        try:
            begun = json.loads(file.read_text())
        except (OSError, ValueError):
            begun = None
        if not isinstance(begun, dict) or begun.keys() != settings.keys():
            raise InputError(
                f"{file}: is torn or not of this program; put a copy in its place, or give another "
                "folder"
            )
        if differ := differences(settings, begun):
            told = "; ".join(differ[:3])
            raise InputError(f"{file}: has other settings: {told}; give these, or another folder")
    elif any(folder.glob(f"**/{CHECKPOINT}")):
        raise InputError(f"{folder}: holds another search's checkpoints; give another folder")
    barrier("all have looked")
    if is_first():
        folder.mkdir(parents=True, exist_ok=True)
        write_json(file, settings)


def _best(
    beta: float, known: list[np.ndarray], efficiencies: np.ndarray, only: np.ndarray
) -> tuple[float, int]:
    """Score and place of the best at beta; of equals at an end, the better at the other task."""
    scores = eta(beta, efficiencies, only)
    other = np.nan_to_num((efficiencies / only).sum(axis=1), nan=-1.0)
    scores = np.where(np.isfinite(scores), scores, -np.inf)
    i = int(np.argmax(scores + 1e-6 * other))
    return float(scores[i]), i


def dominated(points: list[FrontPoint]) -> list[float]:
    """Betas whose neighbours have a design at least as good at both tasks, and better at one."""
    found = []
    for i, point in enumerate(points):
        for neighbour in points[max(0, i - 1) : i + 2]:
            more = neighbour.efficiencies - point.efficiencies
            if np.all(more >= 0.0) and np.any(more > 0.0):
                found.append(point.beta)
    return found
