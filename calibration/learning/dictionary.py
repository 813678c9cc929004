"""Extends a fit problem by the terms of the dictionary, and scores the terms."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome
from calibration.discrepancy.refits import Refits, Tangents, effect_tangents
from calibration.discrepancy.rounds import scoring_entries
from calibration.discrepancy.settings import SelectionSettings
from calibration.inference.gauss_newton import Fit, fit_gauss_newton
from calibration.inference.goodness import excess as channel_excess
from calibration.inference.problem import Swing, TankProblem, total
from calibration.learning.frequencies import SinePeak, best_peak, sine_peaks
from calibration.learning.pursuit import PlaceGain, in_selection, place_gains
from calibration.model.extended import BASE, Parameter, base_values, base_vector, model_parameters
from calibration.model.plan import TrialPlan
from slider_jax.effects.dictionary.details import FINE_PARTS, REAR_PARTS
from slider_jax.effects.functions import Sine
from slider_jax.effects.library import DICTIONARY

Progress = Callable[[str], None]

FREQUENCY_RANGE = 1.2
"""Largest factor between a learned sine's frequency and the frequency of the peak in the residual.
The peak is accurate to a fraction of a Fourier interval, so the fit needs no wider range."""


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
        cls,
        outcome: LoopOutcome,
        effects: Sequence[str],
        contained: Sequence[str],
        scales: Mapping[str, float],
        progress: Progress = lambda text: None,
    ) -> "Dictionary":
        """Returns the problem with the `effects` of the outcome, and with terms at their null.

        The terms are those that can cause the residual. `scales` are the scales of the terms. If
        `effects` is only a part of the outcome's effects, the model is fitted again. Without
        effects, the model is the loop's base model. `contained` are all effects of the compiled
        model, with `effects` among them; the others are at their nulls. Attempts with the same
        `contained` and the same terms use the same compiled programs.
        """
        assert isinstance(outcome.problem, TankProblem)
        used, settings = outcome.used_trials, outcome.search.settings
        source = outcome.chosen if effects else outcome.search.base
        if 0 < len(effects) < len(outcome.effects):
            progress(f"fitting the model with only {', '.join(effects)}")
            source = _with_only(outcome, effects, progress)
        terms = _possible_terms(outcome.problem.part(used), source, settings)
        names = (*contained, *terms)
        entries = model_parameters(names)
        known = {(p.effect, p.name): i for i, p in enumerate(outcome.entries)}
        theta = base_vector(entries, base_values(outcome.experiment))
        swing, free = theta.copy(), []
        for i, p in enumerate(entries):
            own = known.get((p.effect, p.name))
            if own is not None and (not p.effect or p.effect in effects):
                entries[i], theta[i] = outcome.entries[own], source.theta[own]
                free += [i] if own in source.free else []
        start = source._replace(theta=theta, free=np.array(free), linearised_at=None)
        found = _extended(outcome.problem, names, swing)
        peaks = sine_peaks(found.part(used), start, settings.noise_floor)
        for i, p in enumerate(entries):
            if p.effect in DICTIONARY and p.is_shape:
                kind = DICTIONARY[p.effect]
                of_gain = issubclass(kind, Sine) and kind.of_gain
                seen = [peaks[s, of_gain] for s in kind.sensors if (s, of_gain) in peaks]
                peak = best_peak([*seen, SinePeak(1.0, 0.0, p.prior.null)])
                x = np.clip(scales.get(p.effect, peak.frequency), p.prior.low, p.prior.high)
                theta[i] = x
                if p.name == "frequency":
                    low, high = x / FREQUENCY_RANGE, x * FREQUENCY_RANGE
                    entries[i] = p._replace(prior=p.prior._replace(low=low, high=high))
        return cls(outcome, list(effects), found, entries, start)

    @property
    def names(self) -> tuple[str, ...]:
        """All effects of the extended model, including effects at their nulls."""
        return self.problem.coarse_plans[0].extended.effects

    @property
    def replaced(self) -> list[str]:
        """Effects of the outcome that the function replaces."""
        return [name for name in self.outcome.effects if name not in self.effects]

    def with_details(self, terms: Sequence[str]) -> tuple["Dictionary", np.ndarray]:
        """Returns a smaller dictionary with the details of `terms`, and the kept indices.

        It contains the base model, `effects`, `terms` and, at their null, the details. The kept
        indices are the positions in `entries` of its entries without the details.
        """
        origins = {REAR_PARTS[name].name(): name for name in terms if name in REAR_PARTS}
        coarse = {name: name for name in terms} | origins
        origins |= {
            FINE_PARTS[name].name(): term for name, term in coarse.items() if name in FINE_PARTS
        }
        kept = np.flatnonzero([p.effect in ("", *self.effects, *terms) for p in self.entries])
        entries, theta = [self.entries[i] for i in kept], self.start.theta[kept]
        shapes = {(p.effect, p.name): x for p, x in zip(entries, theta, strict=True) if p.is_shape}
        own = model_parameters(tuple(origins))[len(BASE) :]
        values = [shapes[origins[p.effect], p.name] if p.is_shape else p.prior.null for p in own]
        theta, swing = np.concatenate([theta, values]), self.problem.swing
        at_rest = theta if swing is None else np.concatenate([swing.theta[kept], values])
        problem = _extended(self.problem, (*self.effects, *terms, *origins), at_rest)
        free = np.searchsorted(kept, self.start.free)
        start = self.start._replace(theta=theta, free=free, linearised_at=None)
        return replace(self, problem=problem, entries=[*entries, *own], start=start), kept

    @cached_property
    def places(self) -> dict[str, dict[str, np.ndarray]]:
        """The indices of the terms' strengths, by place and term. Each sensor is a place."""
        scored = scoring_entries(self.entries)
        found: dict[str, dict[str, np.ndarray]] = {}
        for name, kind in DICTIONARY.items():
            if name not in scored:
                continue
            sensor = f" ({kind.sensors[0]})" if kind.place() == "Instrument" else ""
            found.setdefault(kind.place() + sensor, {})[name] = scored[name]
        return found

    def search(self, progress: Progress) -> list[PlaceGain]:
        """Returns the result at each place from the readings of the selection."""
        used = self.outcome.used_trials
        problem, predicted = self.problem.part(used).during(in_selection), self.start.predicted
        self.problem.release_whiteners()  # For 50 trials, they need 0.6 GB.
        theta, free = self.start.theta, self.start.free
        white = problem.whiteners(predicted)
        residuals = problem.residuals(predicted, white)
        samples = sum(len(r) for r in residuals.values())
        start = Fit(theta, free, total(residuals), samples, [], predicted, True)
        settings = self.outcome.search.settings
        refits = Refits(problem, self.entries, white, progress, settings)
        tangents = effect_tangents(problem, self.entries, theta, free, settings)
        J: Tangents = {}
        for i in range(len(tangents)):  # Frees the readings that select no term.
            of_trial = {key: x for key, x in white.items() if key[0] == i}
            J |= problem.whitened(tangents, of_trial)
            tangents[i] = np.empty(0)
        return place_gains(refits, start, self.places, J)


def _with_only(outcome: LoopOutcome, effects: Sequence[str], progress: Progress) -> Fit:
    """Returns the fit of the outcome's model with only some of its effects."""
    assert isinstance(outcome.problem, TankProblem)
    theta, free = outcome.chosen.theta.copy(), outcome.chosen.free
    base = outcome.search.base.theta
    others = [i for i, p in enumerate(outcome.entries) if p.effect and p.effect not in effects]
    theta[others] = base[others]
    problem = outcome.problem.part(outcome.used_trials)
    return fit_gauss_newton(problem, outcome.entries, theta, np.setdiff1d(free, others), progress)


def _possible_terms(problem: TankProblem, fit: Fit, settings: SelectionSettings) -> list[str]:
    """Returns the terms that can cause the residual of a fit.

    If the residual of a pressure is above the noise floor, these are the terms that change the
    pressures: forces and motion change a pressure only slightly.
    """
    of_pressure = any(
        c in problem.all_channels.pressures and x.all > settings.noise_floor
        for c, x in channel_excess(problem, fit).items()
    )
    return [n for n, kind in DICTIONARY.items() if not of_pressure or "pressure" in kind.sensors]


def _extended(problem: TankProblem, names: tuple[str, ...], swing: np.ndarray) -> TankProblem:
    """Returns the problem with the effects `names`; `swing` are the swing's parameters."""

    def plans(given: Sequence[TrialPlan]) -> list[TrialPlan]:
        return [replace(p, extended=replace(p.extended, effects=names)) for p in given]

    return replace(
        problem,
        fine=plans(problem.fine),
        coarse_plans=plans(problem.coarse_plans),
        swing=None if problem.swing is None else Swing(problem.swing.size, swing),
    )
