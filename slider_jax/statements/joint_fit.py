"""Searches assumptions with which as many of the paper's statements as possible agree."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from slider_jax import paper
from slider_jax.io.files import provenance
from slider_jax.optimise.loop import Generation, OptimisationResult, run_optimiser, settings_of
from slider_jax.optimise.optimiser import cma_es
from slider_jax.optimise.population import Evaluation
from slider_jax.statements.assumptions import RANGES, from_unit
from slider_jax.statements.facts import facts
from slider_jax.statements.quantities import COARSE, Quantities, StatementSettings, quantities
from slider_jax.statements.statements import A_T, GA, PERFORMANCE, SIMULATED

SWIMMING = tuple(
    name
    for name, one in SIMULATED.items()
    if one.counted and one.place.startswith(("Fig. 7", "Fig. 8", PERFORMANCE, GA))
)
COUNTED = tuple(name for name, one in SIMULATED.items() if one.counted)
ALL = "all statements"
OBJECTIVES: dict[str, tuple[str, ...]] = {
    ALL: COUNTED,
    "head fixed": tuple(name for name in COUNTED if name not in SWIMMING),
    "swimming": SWIMMING,
}
"""Statements that each search counts."""


class Effort(NamedTuple):
    """Settings of a search by CMA-ES, which starts at a random point of the ranges."""

    starts: int = 5
    """Number of random starts for each objective."""
    population: int = 24
    generations: int = 50
    """Number of generations for all statements."""
    of_groups: int = 20
    """Number of generations for the two groups of statements."""
    steps: int = 12
    """Largest number of gradient steps with `FINE`, from the best set of all searches."""

    def searches(self) -> list[tuple[str, int]]:
        """Returns objective and start of each search."""
        groups = [name for name in OBJECTIVES if name != ALL]
        found = [(ALL, start) for start in range(self.starts)]
        return found + [(name, k) for k in range(self.starts) for name in groups]

    def of(self, objective: str) -> int:
        """Returns the number of generations of a search."""
        return self.generations if objective == ALL else self.of_groups


class Simulator:
    """Computes the facts for sets of assumptions, and keeps every evaluated set in a file."""

    def __init__(self, at: StatementSettings = COARSE, log: Path | None = None):
        self.at, self._log = at, log
        self._evaluate = Evaluation(lambda x: quantities(from_unit(x), at), chunk=1)

    def quantities(self, points: np.ndarray) -> list[Quantities]:
        """Returns the simulated quantities for each row of `points` (n, 16) in the unit box."""
        found = self._evaluate(points)
        return [jax.tree.map(lambda x, i=i: x[i], found) for i in range(len(points))]

    def __call__(self, points: np.ndarray) -> list[dict[str, float]]:
        """Returns the facts for each row of `points` (n, 16) in the unit box."""
        results = [facts(row, self.at) for row in self.quantities(points)]
        if self._log is not None:
            _drop_torn_line(self._log)
            with self._log.open("a", encoding="utf-8") as file:
                for point, result in zip(points, results, strict=True):
                    file.write(json.dumps({"point": point.tolist(), "facts": result}) + "\n")
        return results


def _drop_torn_line(path: Path) -> None:
    """Removes an incomplete last line, which an interrupted run leaves."""
    if path.exists():
        content = path.read_bytes()
        if not content.endswith(b"\n"):
            path.write_bytes(content[: content.rfind(b"\n") + 1])


def agreement_score(found: dict[str, float], counted: tuple[str, ...]) -> float:
    """Returns minus the mean of log(1 + miss^2) over the `counted` statements.

    The logarithm limits the influence of statements that cannot agree.
    """
    return -float(np.mean(np.log1p(misses(found, counted) ** 2)))


def misses(found: dict[str, float], counted: tuple[str, ...]) -> np.ndarray:
    """Returns the misses (n,) of the `counted` statements, in tolerances."""
    return np.array([SIMULATED[name].miss(found[SIMULATED[name].fact]) for name in counted])


def random_start(start: int) -> np.ndarray:
    """Returns the point (16,) of the unit box at which search number `start` begins."""
    return np.random.default_rng(start).uniform(0.2, 0.8, len(RANGES))


def search(
    simulate: Simulator,
    objective: str,
    start: int,
    effort: Effort,
    folder: Path,
    on_generation: Callable[[Generation, float], None] = lambda generation, seconds: None,
) -> OptimisationResult:
    """Returns the result of one search; an interrupted search resumes from its checkpoint."""
    counted = OBJECTIVES[objective]
    optimiser = cma_es(effort.population, len(RANGES), random_start(start))

    def evaluate(points: np.ndarray, gradients: bool):
        return np.array([agreement_score(x, counted) for x in simulate(points)]), None

    task: dict[str, Any] = {
        "objective": objective,
        "ranges": {name: [x.low, x.high, x.log] for name, x in RANGES.items()},
        "statements": {name: [SIMULATED[name].low, SIMULATED[name].high] for name in counted},
        "nodes": simulate.at.search.numerics.nodes,
        **provenance(),
    }
    folder.mkdir(parents=True, exist_ok=True)
    settings = settings_of(optimiser, effort.population, start, task)
    return run_optimiser(
        optimiser, evaluate, effort.of(objective), start, settings, folder, resume=True,
        on_generation=on_generation,
    )  # fmt: skip


class Slopes:
    """Computes misses and their derivatives at a point (16,) of the unit box, by forward mode.

    The derivative of the steady speed is that of the implicit function theorem. The fraction of a
    stride with a large recoil counts time steps, so its derivative is zero.
    """

    def __init__(self, at: StatementSettings):
        def both(x):
            found = quantities(from_unit(x), at)
            return found, found

        self._at, self._compiled = at, jax.jit(jax.jacfwd(both, has_aux=True))

    def __call__(
        self, point: np.ndarray, counted: tuple[str, ...]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns the misses (n,) of the `counted` statements, and their derivatives (n, 16)."""
        slopes, found = jax.device_get(self._compiled(np.asarray(point)))

        def misses_at(i: int, step: float) -> np.ndarray:
            moved = jax.tree.map(lambda x, dx: x + step * dx[..., i], found, slopes)
            return misses(facts(moved, self._at), counted)

        columns = [
            (misses_at(i, SMALL) - misses_at(i, -SMALL)) / (2.0 * SMALL) for i in range(len(point))
        ]
        derivatives = np.stack(columns, axis=1)
        return misses(facts(found, self._at), counted), np.where(
            np.abs(derivatives) < STEEP, derivatives, 0.0
        )


SMALL, STEEP = 1e-6, 1e4
"""Step in the unit box for the facts as functions of the quantities, and slope above which a miss
jumps within this step, at an end of a one-sided interval."""
DAMPINGS = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Dampings of a step of Levenberg and Marquardt, relative to the diagonal of the Hessian."""
LONGEST, GAIN = 0.15, 1e-3
"""Longest step along an assumption, as a fraction of its range; smallest gain of the score."""


class Ascent(NamedTuple):
    """Result of the gradient steps of `ascend`."""

    point: np.ndarray
    scores: list[float]
    """Score at the start and after each step that improved it."""
    first: dict[str, float]
    """Facts at the start."""
    last: dict[str, float]
    """Facts at `point`."""


def ascend(
    slopes: Callable[[np.ndarray, tuple[str, ...]], tuple[np.ndarray, np.ndarray]],
    simulate: Callable[[np.ndarray], list[dict[str, float]]],
    start: np.ndarray,
    counted: tuple[str, ...],
    steps: int,
    on_step: Callable[[int, float], None] = lambda step, score: None,
) -> Ascent:
    """Improves a set of assumptions by at most `steps` steps of Levenberg and Marquardt.

    The loss log(1 + miss^2) has the weights 1/(1 + miss^2). Each step simulates one set for each of
    `DAMPINGS`. It ends when none of them improves the score by `GAIN`.
    """
    point = np.asarray(start, float)
    (first,) = simulate(point[None])
    best, last, scores = agreement_score(first, counted), first, []
    scores.append(best)
    for step in range(steps):
        missed, slope = slopes(point, counted)
        weighted = slope / (1.0 + missed**2)[:, None]
        gradient, hessian = weighted.T @ missed, weighted.T @ slope
        free = ~(((point <= 0.0) & (gradient > 0.0)) | ((point >= 1.0) & (gradient < 0.0)))
        diagonal = np.diag(hessian) + 1e-2 * np.max(np.diag(hessian))
        tried = []
        for damping in DAMPINGS:
            move = np.zeros(len(point))
            damped = (hessian + damping * np.diag(diagonal))[np.ix_(free, free)]
            move[free] = -np.linalg.solve(damped, gradient[free])
            tried.append(np.clip(point + move * min(1.0, LONGEST / np.abs(move).max()), 0.0, 1.0))
        found = simulate(np.array(tried))
        reached = [agreement_score(x, counted) for x in found]
        chosen = int(np.argmax(reached))
        if not reached[chosen] > best + GAIN:
            break
        point, best, last = tried[chosen], reached[chosen], found[chosen]
        scores.append(best)
        on_step(step, best)
    return Ascent(point, scores, first, last)


def ascent_record(objective: str, start: int, x: Ascent) -> dict[str, Any]:
    """Returns the record of gradient steps from the best set of a search."""
    return record_of(objective, start, x.point, x.scores[-1], x.last) | {
        "score_before": x.scores[0],
        "agree_before": _agreeing(x.first),
        "steps": len(x.scores) - 1,
    }


def _agreeing(found: dict[str, float]) -> list[str]:
    return [name for name in COUNTED if SIMULATED[name].agrees(found[SIMULATED[name].fact])]


def _values(point: Sequence[float] | np.ndarray) -> dict[str, float]:
    return from_unit(np.asarray(point)).values()


def record_of(
    objective: str, start: int, best: np.ndarray, score: float, reached: dict[str, float]
) -> dict[str, Any]:
    """Returns the record of one search in joint_fit.json; `reached` are the facts at `best`."""
    return {
        "objective": objective,
        "start": start,
        "score": score,
        "agree": _agreeing(reached),
        "facts": {name: reached[name] for name in FRONT_FACTS},
        "assumptions": _values(best),
    }


def witness(name: str, by_point: dict[tuple[float, ...], dict[str, float]]) -> tuple[float, ...]:
    """Returns the set of assumptions that shows best that a statement can agree.

    It has the best score of the sets that agree. If none agrees, it has the smallest miss.
    """
    one = SIMULATED[name]
    agreeing = [point for point, found in by_point.items() if one.agrees(found[one.fact])]
    if agreeing:
        return max(agreeing, key=lambda point: agreement_score(by_point[point], COUNTED))
    return min(by_point, key=lambda point: one.miss(by_point[point][one.fact]))


def summary(
    searches: list[tuple[str, int, OptimisationResult]],
    refined: dict[str, Any],
    evaluated: list[dict[str, Any]],
    effort: Effort,
) -> dict[str, Any]:
    """Returns the content of joint_fit.json.

    `searches` are (objective, start, result). `refined` is the `ascent_record` from the best set of
    the searches. `evaluated` are the rows of `Simulator`'s file.
    """
    by_point = {tuple(row["point"]): row["facts"] for row in evaluated}
    agreeing = {
        name: sum(one.agrees(row[one.fact]) for row in by_point.values())
        for name, one in SIMULATED.items()
    }
    return {
        "refined": refined,
        "evaluated": len(by_point),
        "agreeing": agreeing,
        "witnesses": {name: _values(witness(name, by_point)) for name in SIMULATED},
        "searches": [
            record_of(objective, start, x.best, x.score, by_point[tuple(x.best.tolist())])
            for objective, start, x in searches
        ],
        "front": front(by_point),
        "ranges": {name: [x.low, x.high, x.log] for name, x in RANGES.items()},
        "effort": effort._asdict(),
    }


FRONT_FACTS = ("sweep_peak_N", "sweep_peak_Hz", "tail_amplitude_m", "speed_m_per_s")


def front(by_point: dict[tuple[float, ...], dict[str, float]]) -> list[dict[str, Any]]:
    """Returns the sets of assumptions that no other set surpasses in both ends of the front.

    One end is the largest head-fixed thrust, the other the tail amplitude at the optimum. Both
    errors are logarithms of the ratio to the paper's value.
    """
    ends = (("sweep_peak_N", paper.PEAK_THRUST), ("tail_amplitude_m", A_T[0]))
    rows = []
    for point, found in by_point.items():
        values = np.array([found[name] for name, _ in ends])
        if np.isfinite(values).all() and (values > 0.0).all():
            errors = np.abs(np.log(values / [stated for _, stated in ends]))
            rows.append((errors, point, found))
    rows.sort(key=lambda row: tuple(row[0]))
    kept, least = [], np.inf
    for errors, point, found in rows:
        if errors[1] < least:
            least = errors[1]
            kept.append(
                {
                    "errors": errors.tolist(),
                    "facts": {name: found[name] for name in FRONT_FACTS},
                    "assumptions": _values(point),
                }
            )
    return kept
