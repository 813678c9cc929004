"""Learns the function that is missing in a model if no effect of the library explains the residual.

One half of the trials selects terms from the dictionary (`pursuit`). The other half estimates the
coefficients of the selected terms. The held-out trials test the result.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome, growth_of_error
from calibration.discrepancy.refits import Refits, effect_tangents
from calibration.discrepancy.report import residual_records
from calibration.discrepancy.rounds import relative_changes, scoring_entries
from calibration.discrepancy.verdict import PARTLY, PROVISIONAL, UNEXPLAINED, channels_above_floor
from calibration.inference.gauss_newton import Fit, fit_gauss_newton
from calibration.inference.goodness import Excess, channel_errors, tested_excess
from calibration.inference.problem import Swing, TankProblem, total
from calibration.inference.uncertainty import widen_by_correlation
from calibration.learning.pursuit import (
    MIN_HALF,
    PlaceGain,
    Stability,
    halves,
    place_gains,
    stability,
)
from calibration.learning.states import visited_states
from calibration.model.extended import Parameter, base_values, base_vector, model_parameters
from calibration.model.predict import TrialPlan
from slider_jax.channels import CHANNELS
from slider_jax.effects.library import DICTIONARY

Progress = Callable[[str], None]
RARE = 0.005
"""Fraction of the visited states that lies beyond each end of a function's table, and beyond the
scale of a term. A state has extreme values in the instants when the drive switches."""


@dataclass(frozen=True)
class Dictionary:
    """The fit problem of an outcome, extended by all terms of the dictionary."""

    outcome: LoopOutcome
    effects: list[str]
    """Effects of the outcome that remain in the model beside the function."""
    problem: TankProblem
    """All trials."""
    entries: list[Parameter]
    start: Fit
    """The model without terms, fitted to the trials that were not held out."""

    @classmethod
    def of(
        cls, outcome: LoopOutcome, effects: Sequence[str], progress: Progress = lambda text: None
    ) -> "Dictionary":
        """Returns the problem with the `effects` of the outcome, and with all terms at their null.

        If the outcome has other effects too, the model is fitted again without them.
        """
        assert isinstance(outcome.problem, TankProblem)
        names = (*effects, *DICTIONARY)
        entries = model_parameters(names)
        known = {(p.effect, p.name): i for i, p in enumerate(outcome.entries)}
        source = outcome.chosen if effects else outcome.search.base
        theta = base_vector(entries, base_values(outcome.experiment))
        swing, free = theta.copy(), []
        for i, p in enumerate(entries):
            own = known.get((p.effect, p.name))
            if own is not None:
                entries[i], theta[i] = outcome.entries[own], source.theta[own]
                free += [i] if own in source.free else []
        _set_frequencies(outcome, entries, theta)
        _set_scales(outcome, entries, theta)
        start, problem = source._replace(theta=theta, free=np.array(free)), outcome.problem

        def plans(given: Sequence[TrialPlan]) -> list[TrialPlan]:
            return [replace(p, extended=replace(p.extended, effects=names)) for p in given]

        found = replace(
            problem,
            fine=plans(problem.fine),
            coarse_plans=plans(problem.coarse_plans),
            swing=None if problem.swing is None else Swing(problem.swing.size, swing),
        )
        if 0 < len(effects) < len(outcome.effects):
            progress(f"fitting the model with only {', '.join(effects)}")
            start = fit_gauss_newton(
                found.part(outcome.used_trials), entries, theta, start.free, progress
            )
        return cls(outcome, list(effects), found, entries, start)

    @property
    def replaced(self) -> list[str]:
        """Effects of the outcome that the function replaces."""
        return [name for name in self.outcome.effects if name not in self.effects]

    def started(self, chosen: Sequence[int]) -> list[np.ndarray]:
        """Returns the readings of the model without terms in the trials `chosen`."""
        used = self.outcome.used_trials
        return [self.start.predicted[used.index(i)] for i in chosen]

    @cached_property
    def places(self) -> dict[str, dict[str, np.ndarray]]:
        """The indices of the terms' strengths, by place and term. Each sensor is a place."""
        scored = scoring_entries(self.entries)
        found: dict[str, dict[str, np.ndarray]] = {}
        for name, kind in DICTIONARY.items():
            sensor = f" ({kind.sensors[0]})" if kind.place() == "Instrument" else ""
            found.setdefault(kind.place() + sensor, {})[name] = scored[name]
        return found

    def search(self, chosen: Sequence[int], progress: Progress) -> list[PlaceGain]:
        """Returns the result at each place from the trials `chosen`."""
        problem, predicted = self.problem.part(chosen), self.started(chosen)
        theta, free = self.start.theta, self.start.free
        white = problem.whiteners(predicted)
        residuals = problem.residuals(predicted, white)
        samples = sum(len(r) for r in residuals.values())
        start = Fit(theta, free, total(residuals), samples, [], predicted, True)
        settings = self.outcome.search.settings
        refits = Refits(problem, self.entries, white, progress, settings)
        tangents = effect_tangents(problem, self.entries, theta, free, settings)
        return place_gains(refits, start, self.places, problem.whitened(tangents, white))


def _set_frequencies(outcome: LoopOutcome, entries: Sequence[Parameter], theta: np.ndarray) -> None:
    """Sets the frequency of each sine term to the frequency found in the residual of its sensor."""
    found: dict[str, float] = {}
    for x in residual_records(outcome):
        channel = x["channel"]
        sensor = "pressure" if CHANNELS[channel].kind == "pressure" else channel
        lines = [p for p in outcome.excess[channel].patterns if p.has_line]
        if lines:
            found[sensor] = min(lines, key=lambda p: p.line_p).frequency_Hz
        found.setdefault(sensor, x["in_worst_trial"]["peak_Hz"])
    for i, p in enumerate(entries):
        if p.name == "frequency" and p.effect in DICTIONARY:
            sensor = DICTIONARY[p.effect].sensors[0]
            theta[i] = np.clip(found.get(sensor, p.prior.null), p.prior.low, p.prior.high)


def _set_scales(outcome: LoopOutcome, entries: Sequence[Parameter], theta: np.ndarray) -> None:
    """Sets the scale of each term to the largest state that the trials of the fit visit."""
    assert isinstance(outcome.problem, TankProblem)
    scaled = [i for i, p in enumerate(entries) if p.name == "scale" and p.effect in DICTIONARY]
    terms = {entries[i].effect: DICTIONARY[entries[i].effect]() for i in scaled}
    problem = outcome.problem.part(outcome.used_trials)
    values = jnp.asarray(outcome.chosen.theta)
    visited = [
        visited_states(p, jax.tree.map(jnp.asarray, p.extended.at(values)), y, terms)
        for p, y in zip(problem.coarse_plans, outcome.chosen.predicted, strict=True)
    ]
    for i in scaled:
        p = entries[i]
        z = np.abs(np.concatenate([x[p.effect][""] for x in visited]))
        largest = float(np.quantile(z[np.isfinite(z)], 1.0 - RARE))
        theta[i] = np.clip(largest, p.prior.low, p.prior.high)


@dataclass(frozen=True)
class LearnedModel:
    """A model with a learned function, fitted to the trials that did not select the terms."""

    terms: list[str]
    fit: Fit
    problem: TankProblem
    """The fit problem of the estimation trials."""
    stability: dict[str, Stability]
    errors: dict[str, dict[str, float]]
    """`channel_errors` without and with the function, on the trials `tested`."""
    tested: list[int]
    """The held-out trials, or the estimation trials if no trial was held out."""
    excess: list[dict[str, Excess]]
    """Mean squares of the whitened residual in the estimation trials and in the held-out trials."""
    sizes: dict[str, float]
    """rms change of each channel in the estimation trials, divided by the channel's rms."""

    def above_floor(self, outcome: LoopOutcome) -> list[str]:
        """Returns the channels whose residual is still above the noise floor."""
        settings = outcome.search.settings
        return sorted({c for x in self.excess for c in channels_above_floor(x, settings)})


@dataclass
class Learning:
    """Result of the search for a learned function."""

    dictionary: Dictionary
    selection: list[int] = field(default_factory=list)
    """Trials (indices of all records) that select the terms."""
    estimation: list[int] = field(default_factory=list)
    """Trials that estimate the coefficients."""
    places: list[PlaceGain] = field(default_factory=list)
    """Result at each place, best first."""
    dropped: dict[str, Stability] = field(default_factory=dict)
    """Selected terms that the estimation trials do not confirm."""
    model: LearnedModel | None = None
    reason: str = ""
    """The reason if no function was learned; empty if a function was learned."""

    @property
    def reaches_floor(self) -> bool:
        """Whether a function was learned and the residual with it is at the noise floor."""
        return self.model is not None and not self.model.above_floor(self.dictionary.outcome)

    @property
    def equal_places(self) -> list[str]:
        """Other places whose gain is nearly as large as the gain of the best place."""
        share = self.dictionary.outcome.search.settings.equal_gain_share
        best, *rest = self.places
        return [x.place for x in rest if x.gain > share * best.gain]


def learn_terms(outcome: LoopOutcome, progress: Progress = lambda text: None) -> Learning | None:
    """Returns the result of learning, or None if the verdict requires no learned function.

    An effect with a residual above the noise floor may only resemble the cause. The function is
    therefore learned without such effects first. If the residual with this function remains above
    the noise floor, a function is learned beside all effects too, and the better model is returned.
    """
    if outcome.verdict not in (PARTLY, UNEXPLAINED):
        return None
    statuses = outcome.statuses
    doubtful = [x.name for x in statuses if x.above_floor or x.status == PROVISIONAL]
    found = _learned(outcome, [n for n in outcome.effects if n not in doubtful], progress)
    if not doubtful or not found.estimation or found.reaches_floor:
        return found
    beside = _learned(outcome, outcome.effects, progress)
    if found.model is None or beside.model is None:
        return beside if found.model is None else found
    return beside if beside.model.fit.square < found.model.fit.square else found


def _learned(outcome: LoopOutcome, effects: Sequence[str], progress: Progress) -> Learning:
    """Returns the function that is learned beside the `effects` of the outcome."""
    used = outcome.used_trials
    parts = halves([outcome.problem.records[i].trial.frequency for i in used])
    if len(parts[1]) < MIN_HALF:
        found = Learning(Dictionary.of(outcome, outcome.effects))
        found.reason = (
            f"only {len(used)} trials were not held out; each half needs {MIN_HALF} trials, so an "
            f"experiment needs at least eight usable trials"
        )
        return found
    found = Learning(Dictionary.of(outcome, effects, progress))
    found.selection, found.estimation = ([used[k] for k in part] for part in parts)
    beside = f" beside {', '.join(effects)}" if effects else ""
    progress(f"scoring {len(DICTIONARY)} terms of the dictionary{beside}")
    found.places = found.dictionary.search(found.selection, progress)
    best = found.places[0]
    if not best.groups:
        found.reason = "no term of the dictionary has a significant gain"
        return found
    _estimate(found, best, progress)
    return found


def _estimate(found: Learning, best: PlaceGain, progress: Progress) -> None:
    """Fits the terms of the `best` place to the other half, and sets `model` or `reason`."""
    known = found.dictionary
    problem, groups = known.problem.part(found.estimation), scoring_entries(known.entries)
    terms, theta = best.groups, best.fit.theta
    while terms:
        progress(f"estimating {', '.join(terms)}")
        free = np.concatenate([known.start.free, *(groups[name] for name in terms)])
        fit = fit_gauss_newton(problem, known.entries, theta, free, progress)
        # The held-out trials judge the function, so an incomplete fit may be used.
        if not np.isfinite(fit.errors).all():
            found.reason = f"the model with {', '.join(terms)} cannot be simulated"
            return
        confirmed = {
            name: stability(
                fit.blocks,
                fit.theta[free],
                np.flatnonzero(np.isin(free, groups[name])),
                len(terms),
                fit.inflation,
            )
            for name in terms
        }
        weak = [name for name, x in confirmed.items() if not x.confirmed]
        if not weak:
            _conclude(found, problem, terms, fit, confirmed, progress)
            return
        worst = max(weak, key=lambda name: (confirmed[name].p, confirmed[name].change))
        progress(f"dropping {worst}: the other half of the trials does not confirm it")
        found.dropped[worst] = confirmed[worst]
        terms, theta = [name for name in terms if name != worst], fit.theta.copy()
        theta[groups[worst]] = 0.0
    found.reason = "the other half of the trials does not confirm the selected terms"


def _conclude(
    found: Learning,
    problem: TankProblem,
    terms: list[str],
    fit: Fit,
    confirmed: dict[str, Stability],
    progress: Progress,
) -> None:
    """Tests the fit on the held-out trials, and sets `model` or `reason`."""
    known, outcome = found.dictionary, found.dictionary.outcome
    assert isinstance(outcome.problem, TankProblem)
    own = known.started(found.estimation)
    sizes = relative_changes(problem, own, fit.predicted)
    limits = problem.discrepancies
    if not any(x > limits[c] for c, x in sizes.items()):
        found.reason = "the terms change every channel by less than the discretisation discrepancy"
        return
    excess, tested = [tested_excess(problem, fit)], outcome.held or found.estimation
    errors = channel_errors(problem, own, fit.predicted)
    if outcome.held:
        progress("predicting the held-out trials with the learned function")
        rest = known.problem.part(outcome.held)
        before, after = (rest.predict(x.theta) for x in (known.start, fit))
        of_loop = outcome.problem.part(outcome.held).predict(outcome.chosen.theta)
        if growth_of_error(rest, of_loop, after).vetoes(outcome.search.settings):
            found.reason = "the selected terms increase the error in the held-out trials"
            return
        errors = channel_errors(rest, before, after)
        excess.append(tested_excess(rest, fit._replace(predicted=after)))
    fit = widen_by_correlation(problem, fit)
    found.model = LearnedModel(terms, fit, problem, confirmed, errors, tested, excess, sizes)
