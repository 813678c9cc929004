"""Finds the effects that the model of the arm lacks: scores, refits, cross-validation, verdict.

The scores, the cross-validation, the thresholds and the words of the verdict are those of
`calibration.discrepancy`. The runs take the place of the trials. The errors of one run are
correlated, so the naming threshold has a second part: the gain that the best candidate reaches if
each run's residual gets a random sign.
"""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import f

from calibration.discrepancy.rounds import agreement
from calibration.discrepancy.scores import Score, least_squares_step, score, tangent_cosine
from calibration.discrepancy.settings import DEFAULT_SETTINGS, SelectionSettings
from calibration.discrepancy.verdict import (
    BEYOND_PRIOR,
    CLASS,
    IDENTIFIED,
    NOTHING,
    PARTLY,
    UNEXPLAINED,
)
from calibration.inference.gauss_newton import inverse
from calibration.inference.problem import ChannelBlock, normal_equations, summed
from calibration.tentacle.fit import BASE, BASE_UNITS, ArmFit, ArmProblem, distances, fit_arm
from calibration.tentacle.runs import ArmRuns

MOST_FITTED = 4
"""Most parameters that may be fitted for predictions. Later effects are only reported."""
FLIPS, CHANCE = 1000, 0.05
"""Random signs of the runs, and the probability that chance exceeds the threshold from them."""
NEAR_TENSION = 0.7
"""Largest difference [N] of the tensions of two runs that are compared for the noise floor."""
BEST = 20
"""Number of candidates with the largest gains that are cross-validated and recorded."""
SETTINGS = DEFAULT_SETTINGS


class ArmScore(NamedTuple):
    """A candidate in one round."""

    score: Score
    agreed: bool
    """Whether cross-validation confirms the candidate."""
    seen_mm: float
    held_out_mm: float
    """Mean distance [mm] in all runs and in held-out runs, with the candidate (linearised)."""


class ArmRound(NamedTuple):
    """One round of the selection."""

    scores: list[ArmScore]
    """The best candidates, largest gain first."""
    least_gain: float
    """Gain that a candidate must exceed."""
    refits: dict[str, float]
    """Mean distance [mm] after the refit of each candidate of the short list."""
    chosen: str | None
    equivalent: list[str]
    """Candidates that these runs cannot discriminate from the chosen one."""
    fit: ArmFit
    """The model after the round."""


class ArmSearch(NamedTuple):
    """Result of the selection."""

    start: ArmFit
    """Fit of the base parameters."""
    rounds: list[ArmRound]
    statuses: dict[str, str]
    """Status of each added effect."""
    verdict: str
    used: ArmFit
    """The model that makes the predictions."""
    held_out_mm: dict[str, float]
    """Mean distance [mm] of held-out runs: `base` with the base parameters, `predictions` with the
    parameters of `used`, `selection` if the other runs also select the effects."""
    floors_mm: tuple[float | None, float | None]
    """Noise floors from repeated runs, with the base parameters and with all added effects. None
    without repeated runs."""
    pairs: list[tuple[str, str]]
    """The repeated runs."""


def _blocks(problem: ArmProblem, markers: np.ndarray, J: np.ndarray) -> list[ChannelBlock]:
    runs = range(len(problem.runs.names))
    off = problem.runs.markers - markers
    return normal_equations(
        {(i, "markers"): off[i].ravel() for i in runs},
        {(i, "markers"): J[:, i].reshape(len(J), -1) for i in runs},
    )


def _mean_square(blocks: Sequence[ChannelBlock], free: np.ndarray) -> float:
    """Returns the mean square of the residual after a linear step of the parameters `free`."""
    A, b = summed(blocks)
    left = sum(x.c for x in blocks) - b @ least_squares_step(A, b, free)
    return left / (sum(x.n for x in blocks) - len(free))


def _along(blocks: Sequence[ChannelBlock], free: np.ndarray, many: np.ndarray) -> np.ndarray:
    """Returns each run's residual along each candidate (runs, candidates), orthogonal to `free`.

    The square of a column's sum is the candidate's gain (`calibration.discrepancy.scores`).
    """
    A, b = summed(blocks)
    step = least_squares_step(A, b, free)
    cross = A[np.ix_(free, many)]
    solved = inverse(A[np.ix_(free, free)]) @ cross
    left = np.array([x.b - x.A @ step for x in blocks])
    size = np.diag(A)[many] - np.sum(cross * solved, axis=0)
    seen = size > 1e-9 * np.diag(A)[many]
    scale = np.sqrt(np.where(seen, size, np.inf) * _mean_square(blocks, free))
    return (left[:, many] - left[:, free] @ solved) / scale


def gain_by_chance(blocks: Sequence[ChannelBlock], free: np.ndarray, many: np.ndarray) -> float:
    """Returns the gain that the best of the candidates `many` exceeds by chance in 5 % of cases.

    In each case, the residual of each run has a random sign, so an effect of one sign in all runs
    is destroyed, and the correlation of the errors in a run remains.
    """
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (FLIPS, len(blocks)))
    gains = (signs @ _along(blocks, free, many)) ** 2
    return float(np.quantile(gains.max(axis=1), 1.0 - CHANCE))


def _scored(
    blocks: Sequence[ChannelBlock],
    free: Sequence[int],
    many: Sequence[int],
    names: Sequence[str],
    settings: SelectionSettings,
) -> list[Score]:
    """Returns the scores of the `BEST` of the candidates `many`, largest gain first."""
    own, unit = np.array(free), _mean_square(blocks, np.array(free))
    gains = _along(blocks, own, np.array(many)).sum(axis=0) ** 2
    best = [many[k] for k in np.argsort(-gains)[:BEST]]
    scores = [score(names[i], np.array([i]), own, blocks, unit, len(many), settings) for i in best]
    return sorted(scores, key=lambda s: -s.gain)


def _agreed(s: Score, settings: SelectionSettings) -> bool:
    """Returns whether cross-validation confirms a candidate."""
    return agreement(s.left_out, s.held_gains).agreed(settings)


def _exceeds(s: Score, least: float, settings: SelectionSettings) -> bool:
    """Returns whether a candidate exceeds the naming threshold."""
    return s.gain > least and s.p < settings.false_alarm_p


def _least_gain(blocks, free, many, settings: SelectionSettings) -> float:
    return max(settings.least_gain(), gain_by_chance(blocks, np.array(free), np.array(many)))


def _linear_distances(
    problem: ArmProblem, markers, J, blocks: Sequence[ChannelBlock], free
) -> tuple[float, float]:
    """Returns mean distances [mm] in all runs and in held-out runs after linear steps of `free`."""
    off, own = problem.runs.markers - markers, np.array(free)

    def after(chosen, i=None):
        step = least_squares_step(*summed(chosen), own)
        left = (
            off - np.tensordot(step, J, 1) if i is None else off[i] - np.tensordot(step, J[:, i], 1)
        )
        return 1e3 * np.linalg.norm(left, axis=-1).mean()

    out = [after([x for x in blocks if x.trial != i], i) for i in range(len(off))]
    return float(after(blocks)), float(np.mean(out))


def _held_out_selection(problem: ArmProblem, markers, J, settings: SelectionSettings) -> float:
    """Returns the mean distance [mm] of held-out runs if the other runs also select the effects.

    Scores and fits are linearised at the fit of the base parameters.
    """
    blocks, errors = _blocks(problem, markers, J), []
    for i in range(len(problem.runs.names)):
        others = [x for x in blocks if x.trial != i]
        free = list(range(len(BASE)))
        while len(free) < MOST_FITTED:
            many = [k for k in range(len(BASE), len(J)) if k not in free]
            least = _least_gain(others, free, many, settings)
            found = _scored(others, free, many, problem.names, settings)
            exceeding = (s for s in found if _exceeds(s, least, settings))
            chosen = next((s.name for s in exceeding if _agreed(s, settings)), None)
            if chosen is None:
                break
            free.append(problem.names.index(chosen))
        step = least_squares_step(*summed(others), np.array(free))
        left = problem.runs.markers[i] - markers[i] - np.tensordot(step, J[:, i], 1)
        errors.append(1e3 * np.linalg.norm(left, axis=1).mean())
    return float(np.mean(errors))


def held_out_distance(problem: ArmProblem, fit: ArmFit, slopes: np.ndarray) -> float:
    """Returns the mean distance [mm] of each run with the parameters fitted to all other runs."""
    errors = []
    for i in range(len(problem.runs.names)):
        found = fit_arm(problem, fit.theta, fit.free, slopes, held_out=i)
        errors.append(distances(found.markers, problem.runs)[i].mean())
    problem.markers(fit.theta)
    return float(np.mean(errors))


def repeated_runs(runs: ArmRuns) -> list[tuple[int, int]]:
    """Returns the pairs of runs of different sessions with nearly equal tensions."""
    pulled = runs.tensions > 0.0

    def repeated(i, j):
        known = runs.sessions[i] and runs.sessions[j] and runs.sessions[i] != runs.sessions[j]
        close = np.abs(runs.tensions[i] - runs.tensions[j]).max() < NEAR_TENSION
        return known and close and bool(np.all(pulled[i] == pulled[j]))

    return [x for x in combinations(range(len(runs.names)), 2) if repeated(*x)]


def noise_floor_of(runs: ArmRuns, markers: np.ndarray) -> float | None:
    """Returns the mean distance [mm] that remains if each session has an independent error.

    This is the mean distance between the residuals of repeated runs, divided by the square root of
    two. The markers of a model account for the small difference of the tensions. The floor
    contains all differences between the sessions that the model lacks.
    """
    off = runs.markers - markers
    found = [np.linalg.norm(off[i] - off[j], axis=1).mean() for i, j in repeated_runs(runs)]
    return 1e3 * float(np.mean(found)) / np.sqrt(2.0) if found else None


def close_arm_loop(
    problem: ArmProblem,
    progress: Callable[[str], None] = lambda text: None,
    settings: SelectionSettings = SETTINGS,
) -> ArmSearch:
    """Returns the missing effects of the arm, from the fit of the base parameters onwards."""
    runs = problem.runs
    start = fit = fit_arm(problem, problem.stated, tuple(range(len(BASE))))
    progress(f"base parameters: {distances(fit.markers, runs).mean():.2f} mm")
    rounds: list[ArmRound] = []
    held_out: dict[str, float] = {}
    used = start
    while True:
        J = problem.slopes(fit.theta)
        seen = distances(fit.markers, runs).mean()
        if not rounds:
            held_out["base"] = held_out_distance(problem, fit, J)
            held_out["selection"] = _held_out_selection(problem, fit.markers, J, settings)
            held_out["predictions"] = held_out["base"]
        elif len(fit.free) <= MOST_FITTED:
            found = held_out_distance(problem, fit, J)
            progress(f"  mean distance {seen:.2f} mm, in held-out runs {found:.2f} mm")
            if found < held_out["predictions"]:
                used, held_out["predictions"] = fit, found
        if len(rounds) == settings.max_effects:
            break
        round_ = _round(problem, fit, J, settings, progress)
        rounds.append(round_)
        fit = round_.fit
        if round_.chosen is None:
            break
    floors = noise_floor_of(runs, start.markers), noise_floor_of(runs, fit.markers)
    statuses = {x.chosen: _status(problem, fit, x) for x in rounds if x.chosen}
    pairs = [(runs.names[i], runs.names[j]) for i, j in repeated_runs(runs)]
    last = distances(fit.markers, runs).mean()
    above = above_floor(last, floors[1], len(runs.names), len(pairs), settings)
    verdict = _verdict(statuses, above)
    return ArmSearch(start, rounds, statuses, verdict, used, held_out, floors, pairs)


def _round(problem: ArmProblem, fit: ArmFit, J, settings, progress) -> ArmRound:
    names, runs, free = problem.names, problem.runs, list(fit.free)
    many = [k for k in range(len(BASE), len(J)) if k not in free]
    blocks = _blocks(problem, fit.markers, J)
    least = _least_gain(blocks, free, many, settings)
    scores = []
    for s in _scored(blocks, free, many, names, settings):
        both = [*free, names.index(s.name)]
        seen, held_out = _linear_distances(problem, fit.markers, J, blocks, both)
        scores.append(ArmScore(s, _agreed(s, settings), seen, held_out))
    passed = [x.score for x in scores if x.agreed and _exceeds(x.score, least, settings)]
    refits: dict[str, ArmFit] = {}
    for s in passed[: settings.short_list]:
        refits[s.name] = fit_arm(problem, fit.theta, [*free, names.index(s.name)], J)
        progress(f"  {s.name}: {distances(refits[s.name].markers, runs).mean():.2f} mm")
    sums = {name: np.sum((x.markers - runs.markers) ** 2) for name, x in refits.items()}
    if not sums:
        return ArmRound(scores, least, {}, None, [], fit)
    chosen = min(sums, key=lambda name: sums[name])
    A, mine = summed(blocks)[0], names.index(chosen)
    before = np.sum((fit.markers - runs.markers) ** 2)
    equivalent = []
    for s in passed:
        cosine = tangent_cosine(
            A, np.array([mine]), np.array([names.index(s.name)]), np.array(free)
        )
        gained = before - sums.get(s.name, np.inf)
        equal = gained > settings.equal_gain_share * (before - sums[chosen])
        if s.name != chosen and (equal or cosine > settings.parallel_cosine):
            equivalent.append(s.name)
    progress(f"added {chosen}" + (f", equivalent: {', '.join(equivalent)}" * bool(equivalent)))
    means = {name: float(distances(x.markers, runs).mean()) for name, x in refits.items()}
    best = fit_arm(problem, refits[chosen].theta, refits[chosen].free)
    return ArmRound(scores, least, means, chosen, equivalent, best)


def above_floor(
    distance: float,
    floor: float | None,
    runs: int,
    pairs: int,
    settings: SelectionSettings = SETTINGS,
) -> bool:
    """Returns whether a mean distance [mm] is above the noise floor [mm]; True without a floor.

    The mean squares are in the ratio of the squared distances. Few repeated runs determine the
    floor roughly, so the ratio must also exceed the limit of an F-test of two variances. The errors
    of one run are correlated, so each run and each pair counts as one sample.
    """
    if floor is None:
        return True
    chance = f.isf(CHANCE, runs, pairs)
    return bool((distance / floor) ** 2 > max(settings.noise_floor, chance))


def _status(problem: ArmProblem, fit: ArmFit, round_: ArmRound) -> str:
    i = problem.names.index(str(round_.chosen))
    prior = problem.candidates[i - len(BASE)].prior
    if round_.equivalent:
        return CLASS
    return IDENTIFIED if prior.low <= fit.theta[i] <= prior.high else BEYOND_PRIOR


def _verdict(statuses: dict[str, str], above: bool) -> str:
    if above:
        return PARTLY if statuses else UNEXPLAINED
    if not statuses:
        return NOTHING
    return CLASS if CLASS in statuses.values() else IDENTIFIED


def search_record(problem: ArmProblem, search: ArmSearch) -> dict[str, Any]:
    """Returns the content of close_loop.json."""
    units = dict(zip(BASE, BASE_UNITS, strict=True))
    units |= {x.name: x.prior.unit for x in problem.candidates}

    def fitted(fit: ArmFit):
        return {
            problem.names[i]: {"value": float(fit.theta[i]), "unit": units[problem.names[i]]}
            for i in fit.free
        }

    def seen(fit: ArmFit):
        return float(distances(fit.markers, problem.runs).mean())

    last = search.rounds[-1].fit if search.rounds else search.start
    return {
        "verdict": search.verdict,
        "effects": search.statuses,
        "mean_distance_mm": {
            "base": seen(search.start),
            "predictions": seen(search.used),
            "all_added_effects": seen(last),
        },
        "mean_distance_of_held_out_runs_mm": search.held_out_mm,
        "noise_floor_mm": dict(zip(("base", "all_added_effects"), search.floors_mm, strict=True)),
        "repeated_runs": search.pairs,
        "base": fitted(search.start),
        "predictions": fitted(search.used),
        "all_added_effects": fitted(last),
        "rounds": [
            {
                "chosen": x.chosen,
                "equivalent": x.equivalent,
                "least_gain": x.least_gain,
                "refitted_mean_distance_mm": x.refits,
                "candidates": [
                    {
                        "name": y.score.name,
                        "gain": y.score.gain,
                        "agreed": y.agreed,
                        "mean_distance_mm": y.seen_mm,
                        "held_out_mean_distance_mm": y.held_out_mm,
                    }
                    for y in x.scores
                ],
            }
            for x in search.rounds
        ],
        "prior_ranges": {
            x.name: {
                "low": x.prior.low,
                "high": x.prior.high,
                "unit": x.prior.unit,
                "why": x.prior.why,
            }
            for x in problem.candidates
        },
    }
