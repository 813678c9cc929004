"""Learns the function that is missing in a model.

This happens if no effect of the library explains the residual, or if the named effects are
doubtful.

One half of each trial selects terms from the dictionary (`pursuit`). The other half confirms the
selected terms. Both halves estimate the coefficients. The held-out trials test the result.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome, growth_of_error
from calibration.discrepancy.refits import Refits, effect_tangents
from calibration.discrepancy.rounds import Growth, relative_changes, scoring_entries
from calibration.discrepancy.settings import SelectionSettings
from calibration.discrepancy.verdict import (
    CLASS,
    IDENTIFIED,
    LEARNED,
    PARTLY,
    UNEXPLAINED,
    channels_above_floor,
)
from calibration.inference.gauss_newton import Bounds, Fit, fit_gauss_newton
from calibration.inference.goodness import Excess, channel_errors, excess_removed, tested_excess
from calibration.inference.problem import FAILED, TankProblem, total
from calibration.inference.uncertainty import widen_by_correlation
from calibration.learning.dictionary import Dictionary, Progress
from calibration.learning.pursuit import (
    MIN_TRIALS,
    PlaceGain,
    Stability,
    in_selection,
    pursue,
    stability,
)
from calibration.learning.states import OF_CHAMBERS, largest_states
from calibration.model.extended import Parameter
from slider_jax.effects import Effect
from slider_jax.effects.dictionary.details import DETAILS, REAR_PARTS
from slider_jax.effects.library import DICTIONARY, LIBRARY
from slider_jax.programs import return_freed_memory

NOT_CONFIRMED = "other trials do not confirm the selected terms"
VETOED = "the selected terms increase the error in the held-out trials"
WORSE = "the selected terms explain the data worse than the added effects"
LEAST_REMOVED = 0.2
"""A function that does not reach the noise floor must remove at least this fraction of the excess
error in the tested trials. A smaller fraction does not support the function's place. The value
was chosen after two tanks in which a function at a wrong place removed less than 0.05."""
TOO_LITTLE = (
    f"the function removes less than {100 * LEAST_REMOVED:.0f} % of the rms error "
    "above the noise floor"
)
CONTRADICTIONS = (NOT_CONFIRMED, VETOED, TOO_LITTLE)
"""Reasons for which other trials contradict the terms of a place."""
DOUBT_P = 1e-4
"""Named effects are doubtful if the corrected p-value of a candidate beside them is below this. In
five tanks with a wrong name, the smallest p-values are 4e-6 and less; in ten tanks with a right
name, 9e-4 and more. The value was chosen with these tanks."""


@dataclass(frozen=True)
class LearnedModel:
    """A model with a learned function, fitted to all trials that were not held out."""

    dictionary: Dictionary
    terms: list[str]
    """Terms of the function, and the rear parts of terms."""
    fit: Fit
    problem: TankProblem
    """The fit problem of the trials that were not held out."""
    stability: dict[str, Stability]
    """p-value of each term in the estimation half, and its change in the fit to both halves."""
    errors: dict[str, dict[str, float]]
    """`channel_errors` without and with the function, on the trials `tested`."""
    growth: Growth
    """Growth of the error in the trials `tested`, relative to the loop's model with all effects."""
    tested: list[int]
    """The held-out trials, or all trials if no trial was held out."""
    excess: list[dict[str, Excess]]
    """Mean squares of the whitened residual in the fitted trials and in the held-out trials."""
    sizes: dict[str, float]
    """rms change of each channel in the fitted trials, divided by the channel's rms."""

    @property
    def fine_parts(self) -> list[str]:
        """Fine parts of the terms in the model."""
        found = dict.fromkeys(self.dictionary.entries[i].effect for i in self.fit.free)
        return [name for name in found if name in DETAILS and name not in self.terms]

    @property
    def above_floor(self) -> list[str]:
        """Channels whose residual is still above the noise floor."""
        settings = self.dictionary.outcome.search.settings
        return sorted({c for x in self.excess for c in channels_above_floor(x, settings)})


@dataclass
class Learning:
    """Result of the search for a learned function."""

    outcome: LoopOutcome
    places: list[PlaceGain] = field(default_factory=list)
    """Result at each place: the place of the learned function, then the others, best first."""
    refused: dict[str, str] = field(default_factory=dict)
    """Places whose terms a later test refused, with the reason. The next place was tried then."""
    dropped: dict[str, Stability] = field(default_factory=dict)
    """Selected terms that other trials do not confirm."""
    model: LearnedModel | None = None
    reason: str = ""
    """The reason if no function was learned; empty if a function was learned."""

    @property
    def reaches_floor(self) -> bool:
        """Whether a function was learned and the residual with it is at the noise floor."""
        return self.model is not None and not self.model.above_floor

    @property
    def equal_places(self) -> list[str]:
        """Other places whose gain is nearly as large as the gain of the function's place.

        Places whose terms other trials contradict do not count.
        """
        share = self.outcome.search.settings.equal_gain_share
        best, *rest = self.places
        contradicted = [place for place, why in self.refused.items() if why in CONTRADICTIONS]
        return [x.place for x in rest if x.place not in contradicted and x.gain > share * best.gain]


def learn_terms(outcome: LoopOutcome, progress: Progress = lambda text: None) -> Learning | None:
    """Returns the result of learning, or None if the verdict requires no learned function.

    If effects were named but may only resemble the cause (`_are_doubtful`), a function may explain
    the data better, or as well with fewer terms. Then the result contains this function and an
    outcome with the verdict `learned`, whose effects are corrections. Otherwise, the result is
    None.

    If the residual is above the noise floor, an added effect may only resemble the cause. The
    function is therefore learned without effects first, then beside the effects that are not
    corrections, then beside all effects. The result is the first function that reaches the noise
    floor. Without such a function, the result is the function with the smallest error in the tested
    trials, if this error is below the error of the loop's model.
    """
    doubtful = outcome.verdict in (IDENTIFIED, CLASS) and _are_doubtful(outcome)
    if not doubtful and outcome.verdict not in (PARTLY, UNEXPLAINED):
        return None
    used = outcome.used_trials
    if len(used) < MIN_TRIALS:
        if doubtful:
            return None
        few = Learning(outcome)
        few.reason = (
            f"only {len(used)} trials were not held out; a function needs {MIN_TRIALS} "
            f"of these trials, so an experiment with eight usable trials is enough"
        )
        return few
    assert isinstance(outcome.problem, TankProblem)
    return_freed_memory()  # otherwise it adds 0.8 GB to the memory of the dictionary
    scales = largest_states(outcome.problem.part(used), outcome.chosen)
    if doubtful:
        progress(f"testing whether a function replaces {', '.join(outcome.effects)}")
        # Without the effects, the programs are the same for every experiment.
        known = Dictionary.of(outcome, [], [], scales, progress)
        found = _learned(Learning(outcome), known, progress, _competes)
        if found.model is None or not _replaces_effects(found.model, outcome):
            return None
        found.outcome = replace(outcome, verdict=LEARNED, replaceable=True)
        return found

    def learned(effects: Sequence[str]) -> Learning:
        known = Dictionary.of(outcome, effects, outcome.effects, scales, progress)
        return _learned(Learning(outcome), known, progress)

    kept = [n for n in outcome.effects if n not in outcome.corrections]
    attempts: list[Learning] = []
    for effects in sorted({(), tuple(kept), tuple(outcome.effects)}, key=len):
        attempts.append(learned(effects))
        if attempts[-1].reaches_floor:
            return attempts[-1]
    better = [
        (x.model.growth.mean, k)
        for k, x in enumerate(attempts)
        if x.model is not None and x.model.growth.mean < 0.0
    ]
    if better:
        return attempts[min(better)[1]]
    last = attempts[-1]
    if last.model is not None:
        last.model = None
        last.reason = "the function does not lower the error below the error of the loop's model"
    return last


def _are_doubtful(outcome: LoopOutcome) -> bool:
    """Returns whether the named effects may only resemble the cause.

    There are four reasons: a candidate that was not added has a significant score in the last
    round (p < `DOUBT_P`); a parameter of an effect is at the end of its range, which limits the
    effect; the model has three effects; or it has two effects in the same part of the rig. Without
    a reason, a function rarely explains the data better, so the test would only cost time.
    """
    effects, fit, settings = outcome.effects, outcome.chosen, outcome.search.settings
    parts = {_part_of_rig(LIBRARY[name]) for name in effects}
    if len(effects) > 2 or (len(effects) == 2 and len(parts) == 1):
        return True
    # A physical limit counts too: an effect at its limit may have the wrong law.
    own = [int(i) for i in fit.free if outcome.entries[i].effect]
    bounds = Bounds.of([outcome.entries[i] for i in own])
    share = bounds.share_of(fit.theta[own])
    if np.any(np.minimum(share, 1.0 - share) < settings.bound_margin):
        return True
    scores = outcome.search.rounds[-1].scores
    return any(x.p < DOUBT_P and x.name not in effects for x in scores)


def _part_of_rig(kind: type[Effect]) -> str:
    """Returns the part of the rig in which an effect acts: pneumatics, body, water or sensors."""
    place = kind.place()
    if place in OF_CHAMBERS:
        return "pneumatics"
    if place == "Instrument":
        return f"sensors of {', '.join(kind.sensors)}"
    return "water" if place in ("ForceDensity", "WakeForce", "WaterMotion") else "body"


def _sum_of_least_gains(
    entries: Sequence[Parameter],
    free: np.ndarray,
    names: Sequence[str],
    settings: SelectionSettings,
) -> float:
    """Returns the sum of the gains that each effect or term in `names` must exceed."""
    fitted = [entries[i].effect for i in free]
    return sum(settings.least_gain(fitted.count(name)) for name in names)


def _loss(problem: TankProblem, chosen: Fit, predicted: list[np.ndarray]) -> float:
    """Returns the increase of the sum of squares from `chosen` to the readings `predicted`.

    The unit is the mean square of the residual of `chosen`.
    """
    white = problem.whiteners(chosen.predicted)
    own, other = (total(problem.residuals(y, white)) for y in (chosen.predicted, predicted))
    return (other - own) / chosen.inflation


def _competes(known: Dictionary, place: PlaceGain) -> bool:
    """Returns whether terms may replace all effects, judged by the readings of the selection.

    The loss may be up to the gains that the effects require: the fit of the terms is rough, and
    details can improve it.
    """
    outcome = known.outcome
    problem = known.problem.part(outcome.used_trials).during(in_selection)
    loss = _loss(problem, outcome.chosen, place.fit.predicted)
    settings = outcome.search.settings
    return loss <= _sum_of_least_gains(
        outcome.entries, outcome.chosen.free, outcome.effects, settings
    )


def _replaces_effects(learned: LearnedModel, outcome: LoopOutcome) -> bool:
    """Returns whether a function explains the data better than the effects, or as well.

    As in the selection, each effect and each term must lower the sum of squares by the `least_gain`
    of its number of parameters. A function with fewer terms than effects may explain the data as
    well. Any other function must lower the sum of squares by a further `least_gain`, and lower the
    error in the tested trials.
    """
    if learned.above_floor:
        return False
    chosen, settings = outcome.chosen, outcome.search.settings
    terms = [*learned.terms, *learned.fine_parts]
    allowed = _sum_of_least_gains(outcome.entries, chosen.free, outcome.effects, settings)
    allowed -= _sum_of_least_gains(learned.dictionary.entries, learned.fit.free, terms, settings)
    if len(learned.terms) >= len(outcome.effects):
        if learned.growth.mean >= 0.0:
            return False
        allowed -= settings.least_gain()
    return _loss(learned.problem, chosen, learned.fit.predicted) <= allowed


def _learned(
    found: Learning,
    known: Dictionary,
    progress: Progress,
    accepts: Callable[[Dictionary, PlaceGain], bool] = lambda known, place: True,
) -> Learning:
    """Selects and estimates terms of the dictionary. Returns `found` with the result.

    The terms of a place are only estimated if `accepts` returns true for the place.
    """
    beside = f" beside {', '.join(known.effects)}" if known.effects else ""
    progress(f"scoring {sum(map(len, known.places.values()))} terms of the dictionary{beside}")
    found.places = known.search(progress)
    tried = [x for x in found.places if x.groups]
    many = sum(len(x.groups) for x in tried)
    for place in tried:
        if not accepts(known, place):
            found.refused[place.place] = WORSE
            continue
        _estimate(found, known, place, many, progress)
        if found.model is not None:
            found.places = [place, *(x for x in found.places if x is not place)]
            return found
        found.refused[place.place] = found.reason
    nothing = "no term of the dictionary has a significant gain"
    found.reason = next(iter(found.refused.values()), nothing)
    return found


def _estimate(
    found: Learning, known: Dictionary, best: PlaceGain, many: int, progress: Progress
) -> None:
    """Fits the terms of the place `best` to the other half, and sets `model` or `reason`.

    A term that the other half does not confirm is dropped. If the other half confirms every term,
    the terms are fitted to both halves, and the details that lower the error enough are added. If
    the function then depends on a single trial, the term that changes most is dropped, and the
    search begins again. `many` is the number of selected terms of all places; the p-values are
    corrected for it.
    """
    both = known.problem.part(found.outcome.used_trials)
    half = both.during(lambda record: ~in_selection(record))
    groups, terms, theta = scoring_entries(known.entries), best.groups, best.fit.theta
    while terms:
        progress(f"estimating {', '.join(terms)}")
        sines = [
            i for i, p in enumerate(known.entries) if p.effect in terms and p.name == "frequency"
        ]
        own = {name: groups[name] for name in terms}
        free = np.concatenate([known.start.free, *own.values(), np.array(sines, int)])
        places = {name: np.flatnonzero(np.isin(free, group)) for name, group in own.items()}
        fit = _fitted(found.outcome, known.entries, half, own, theta, free, progress)
        if isinstance(fit, str):
            found.reason = fit
            return
        confirmed = {n: stability(fit, x, many) for n, x in places.items()}
        worst = max(reversed(terms), key=lambda name: confirmed[name].p)
        if confirmed[worst].significant:
            progress(f"fitting {', '.join(terms)} to both halves")
            fit = _fitted(found.outcome, known.entries, both, own, fit.theta, free, progress)
            if isinstance(fit, str):
                found.reason = fit
                return
            changes = {n: stability(fit, x, many).change for n, x in places.items()}
            confirmed = {n: x._replace(change=changes[n]) for n, x in confirmed.items()}
            finer = _with_details(known, terms, fit, found.outcome, progress)
            stable = [x for x in (finer, (known, fit)) if x is not None and _is_stable(*x, many)]
            for model in stable:
                _conclude(found, *model, terms, confirmed, progress)
                if found.model is not None:
                    break
            if stable:
                return
            worst = max(terms, key=lambda name: changes[name])
        progress(f"dropping {worst}: other trials do not confirm it")
        found.dropped[worst] = confirmed[worst]
        terms, theta = [name for name in terms if name != worst], fit.theta.copy()
        theta[groups[worst]] = 0.0
    found.reason = NOT_CONFIRMED


def _fitted(
    outcome: LoopOutcome,
    entries: Sequence[Parameter],
    problem: TankProblem,
    strengths: Mapping[str, np.ndarray],
    theta: np.ndarray,
    free: np.ndarray,
    progress: Progress,
) -> Fit | str:
    """Returns the fit of the terms with the indices `strengths`, or the reason for a failure."""
    start, names = theta.copy(), ", ".join(strengths)
    for _ in range(1 + outcome.search.settings.max_halvings):
        fit = fit_gauss_newton(problem, entries, start, free, progress)
        if fit.square < FAILED and np.isfinite(fit.errors).all():
            break
        for group in strengths.values():  # a function of other trials can be too large for these
            start[group] *= 0.5
    else:
        return f"the simulation or a derivative of the model with {names} failed"
    # Held-out trials judge the function, so that an incomplete fit may be used.
    if not (fit.converged or outcome.held):
        return f"the fit with {names} did not converge"
    return fit


def _is_stable(known: Dictionary, fit: Fit, many: int) -> bool:
    """Returns whether the trials of the fit confirm the function as a whole."""
    entries = [known.entries[i] for i in fit.free]
    of_function = [
        (p.effect in DICTIONARY or p.effect in DETAILS) and not p.is_shape for p in entries
    ]
    return stability(fit, np.flatnonzero(of_function), many).confirmed


def _with_details(
    known: Dictionary, terms: Sequence[str], fit: Fit, outcome: LoopOutcome, progress: Progress
) -> tuple[Dictionary, Fit] | None:
    """Returns the model with the details that lower the error enough, fitted to both halves.

    `fit` is the fit with the `terms`. None: no detail was added.
    """
    details, kept = known.with_details(terms)
    groups = {n: x for n, x in scoring_entries(details.entries).items() if n in DETAILS}
    if not groups:
        return None
    progress(f"scoring {len(groups)} details")
    theta = details.start.theta.copy()
    theta[: len(kept)] = fit.theta[kept]
    free = np.searchsorted(kept, fit.free)
    start = fit._replace(theta=theta, free=free, linearised_at=None)
    problem, settings = details.problem.part(outcome.used_trials), outcome.search.settings
    white = problem.whiteners(fit.predicted)
    refits = Refits(problem, details.entries, white, progress, settings)
    tangents = effect_tangents(problem, details.entries, theta, free, settings)
    J = problem.whitened(tangents, white, in_place=True)
    found = pursue(refits, start, "details", groups, J, len(groups))
    own = {name: groups[name] for name in found.groups}
    if not own:
        return None
    progress(f"fitting {', '.join(own)} to both halves")
    free = np.concatenate([free, *own.values()])
    finer = _fitted(outcome, details.entries, problem, own, found.fit.theta, free, progress)
    return None if isinstance(finer, str) else (details, finer)


def _conclude(
    found: Learning,
    known: Dictionary,
    fit: Fit,
    terms: list[str],
    confirmed: dict[str, Stability],
    progress: Progress,
) -> None:
    """Tests the fit to both halves on the held-out trials, and sets `model` or `reason`."""
    outcome, problem = found.outcome, known.problem.part(found.outcome.used_trials)
    tested = outcome.held or outcome.used_trials
    assert isinstance(outcome.problem, TankProblem)
    own = known.start.predicted
    sizes = relative_changes(problem, own, fit.predicted)
    limits = problem.discrepancies
    if not any(x > limits[c] for c, x in sizes.items()):
        found.reason = "the terms change every channel by less than the discretisation discrepancy"
        return
    excess, rest, before, after = [tested_excess(problem, fit)], problem, own, fit.predicted
    if outcome.held:
        progress("predicting the held-out trials with the learned function")
        rest = known.problem.part(tested)
        before, after = (rest.predict(x.theta) for x in (known.start, fit))
        excess.append(tested_excess(rest, fit._replace(predicted=after)))
    of_loop = outcome.problem.part(tested).predict(outcome.chosen.theta)
    growth = growth_of_error(rest, of_loop, after)
    if growth.vetoes(outcome.search.settings):
        found.reason = VETOED
        return
    errors = channel_errors(rest, before, after)
    fit = widen_by_correlation(problem, fit)
    of_rear = [REAR_PARTS[name].name() for name in terms if name in REAR_PARTS]
    fitted = {known.entries[i].effect for i in fit.free}
    terms = [*terms, *(name for name in of_rear if name in fitted)]
    model = LearnedModel(
        known, terms, fit, problem, confirmed, errors, growth, tested, excess, sizes
    )
    removed = excess_removed(errors)
    if model.above_floor and removed is not None and removed < LEAST_REMOVED:
        found.reason = TOO_LITTLE
        return
    found.model, found.reason = model, ""
