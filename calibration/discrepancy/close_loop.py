"""Closes the loop on an experiment: measured trials give a verdict and a better model."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.audit.audit import audit_measurements
from calibration.audit.prediction import residual_outliers
from calibration.discrepancy.ranges import fix_undetermined_shapes, widen_ranges
from calibration.discrepancy.refits import FitStart, Refits
from calibration.discrepancy.rounds import Growth, Selection, effect_entries
from calibration.discrepancy.selection import select_effects
from calibration.discrepancy.settings import DEFAULT_SETTINGS, SelectionSettings
from calibration.discrepancy.verdict import EffectStatus, judge_effects, reach_verdict
from calibration.inference.cache import Memo
from calibration.inference.gauss_newton import (
    Fit,
    derivatives_of_fit,
    fit_gauss_newton,
    reading_derivatives,
)
from calibration.inference.goodness import (
    Excess,
    channel_errors,
    excess,
    tested_excess,
    whitened_residuals,
)
from calibration.inference.measured_noise import ChannelNoise, measured_noises
from calibration.inference.noise import Noise
from calibration.inference.problem import FAILED, AbstractProblem, TankProblem, total
from calibration.inference.tails import Tails, heavy_tails
from calibration.inference.uncertainty import (
    Instability,
    confidence_interval,
    hausman_check,
    shift_by_discrepancy,
    unstable_parameters,
    widen_by_correlation,
)
from calibration.measurements.records import Finding, Record
from calibration.model.compiled import background_thread
from calibration.model.extended import (
    BASE,
    Parameter,
    base_values,
    base_vector,
    candidate_effects,
    model_parameters,
)
from calibration.model.plan import COARSE, FINE, Resolution
from slider_jax.experiment.load import Experiment


@dataclass(frozen=True)
class LoopOutcome:
    """The result of the loop on one experiment."""

    experiment: Experiment
    entries: Sequence[Parameter]
    """Entries of the parameter vector, with the prior ranges of the final fit."""
    verdict: str
    search: Selection
    final: Fit
    """The chosen model, refitted to all trials."""
    problem: AbstractProblem
    """The fit problem of all trials."""
    used: dict[str, dict[str, float]]
    """`channel_errors` (rms errors by channel) of the trials that were used to select effects."""
    held_out: dict[str, dict[str, float]]
    """`channel_errors` of the held-out trials; empty if there are none."""
    excess: dict[str, Excess]
    """Mean squares of the chosen model's whitened residual in the trials of the selection."""
    held: list[int]
    """Held-out trials, as indices of `problem.records`."""
    audit: list[Finding] = field(default_factory=list)
    """Faults of the data and the actions taken."""
    noise: dict[str, ChannelNoise] = field(default_factory=dict)
    """Declared, measured and used white noise of each channel; empty for pressure logs."""
    replaceable: bool = False
    """Whether a learned function explains the data better, or as well with fewer terms."""

    @property
    def unstable(self) -> list[Instability]:
        """Parameters with different values in the first and the second half of the trials."""
        return unstable_parameters(self.final, self.entries)

    @property
    def corrections(self) -> list[str]:
        """Added effects that may be absent or only resemble the cause."""
        return [x.name for x in self.statuses if x.is_correction]

    @property
    def effects(self) -> list[str]:
        """Effects added to the model: all effects that passed their tests."""
        return self.search.effects

    @property
    def statuses(self) -> list[EffectStatus]:
        """Status of each added effect."""
        return judge_effects(
            self.search, self.final, self.excess, self.problem.all_channels, self.replaceable
        )

    @property
    def chosen(self) -> Fit:
        """The chosen model, fitted to the trials that were not held out."""
        return self.search.final

    @property
    def used_trials(self) -> list[int]:
        """Trials that were not held out, as indices of `problem.records`."""
        return [i for i in range(len(self.problem.records)) if i not in self.held]

    def interval(self, index: int) -> tuple[float, float, float]:
        """Returns value, lower and upper 95 % bound of the fitted parameter `entries[index]`."""
        return confidence_interval(self.final, self.entries, index)


def choose_held_out(
    found: Sequence[Record],
    kept: Collection[str] = (),
    settings: SelectionSettings = DEFAULT_SETTINGS,
) -> list[int]:
    """Returns the indices of about a quarter of the trials, or none if there are too few trials.

    The held-out trials cover the range of frequencies without the lowest and highest frequency. At
    least two towed trials and two trials in still water remain in the fit, because an effect may
    act on one of these two kinds only. Trials of the files `kept` always remain in the fit.
    """
    if len(found) < 2 * settings.min_trials:
        return []
    order = sorted(range(len(found)), key=lambda i: (found[i].trial.frequency or 0.0, i))
    towed = [found[i].trial.tow_speed != 0.0 for i in range(len(found))]
    held: list[int] = []
    for place in range(2, len(order) - 1, 4):
        near = [order[j] for j in (place, place - 1, place + 1) if 0 < j < len(order) - 1]
        for i in [i for i in near if found[i].trial.file not in kept]:
            rest = [towed[j] for j in order if j not in (*held, i)]
            if i not in held and (rest.count(towed[i]) >= 2 or rest.count(not towed[i]) == 0):
                held.append(i)
                break
    return sorted(held)


def close_loop_on_trials(
    experiment: Experiment,
    effects: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda text: None,
    fine: Resolution = FINE,
    coarse: Resolution = COARSE,
    memo: Memo | None = None,
    kept: Collection[str] = (),
    settings: SelectionSettings = DEFAULT_SETTINGS,
) -> LoopOutcome:
    """Returns the loop's result: the effects that are missing in the model of the measured trials.

    The audit decides which readings `close_loop_on_records` uses. The arguments are the same.
    Raises `InputError` if fewer than `settings.min_trials` trials can be used.
    """
    names = tuple(candidate_effects() if effects is None else effects)
    initial = base_vector(model_parameters(names), base_values(experiment))
    with background_thread() as background:

        def predict(few: Sequence[Record]) -> list[np.ndarray]:
            # While the coarse mesh simulates, the other thread compiles the programs for later.
            problem = TankProblem.of(experiment, list(few), names, fine=fine, coarse=coarse)
            for compile_programs in problem.compilations(initial):
                background.submit(compile_programs)
            return problem.on_coarse_mesh().predict(initial)

        progress("auditing the data")
        audited = audit_measurements(experiment, settings.min_trials, predict)
        for finding in audited.findings:
            progress(str(finding))
        outcome = close_loop_on_records(
            experiment, audited.records, names, progress, fine, coarse, memo, kept, settings
        )
    return replace(outcome, audit=[*audited.findings, *outcome.audit])


def close_loop_on_records(
    experiment: Experiment,
    records: Sequence[Record],
    effects: Sequence[str],
    progress: Callable[[str], None] = lambda text: None,
    fine: Resolution = FINE,
    coarse: Resolution = COARSE,
    memo: Memo | None = None,
    kept: Collection[str] = (),
    settings: SelectionSettings = DEFAULT_SETTINGS,
) -> LoopOutcome:
    """Returns the loop's result on audited readings.

    `effects` are the candidates' names. Residuals are computed at the resolution `fine` and
    tangents at `coarse`. Trials of the files `kept` are not held out. Outlying trials are left out,
    and the loop runs again. If the noise of a channel has heavy tails, the loop runs again with
    weights for this noise.
    """
    names, base = tuple(effects), base_values(experiment)
    noise = measured_noises(experiment.sensors, records)
    weighed: dict[tuple[str, str], Noise] = {}
    for channel, x in noise.items():
        if x.replaced:
            progress(f"{channel}: the measured noise replaces the declared noise")

    def problem_of(chosen: Sequence[Record]) -> TankProblem:
        problem = TankProblem.of(
            experiment, list(chosen), names, fine=fine, coarse=coarse, measured=noise
        )
        own = {
            (i, channel): weighed.get((chosen[i].trial.file, channel), x)
            for (i, channel), x in problem.noise.items()
        }
        return replace(problem, memo=memo, noise=own)

    def outcome_of(records: Sequence[Record]) -> LoopOutcome:
        held = choose_held_out(records, kept, settings)
        return conclude(
            experiment, names, records, held, problem_of, base, tuple(BASE), progress, settings
        )

    outcome = outcome_of(records)
    residuals = whitened_residuals(outcome.problem, outcome.final)
    each = excess(outcome.problem, outcome.final, residuals)
    trials = [r.trial for r in outcome.problem.records]
    outlying = residual_outliers(trials, {c: x.trials for c, x in each.items()})
    named = {x.trial for x in outlying}
    rest = [r for r in records if r.trial.file not in named]
    if outlying and len(rest) >= settings.min_trials:
        for finding in outlying:
            progress(str(finding))
        outcome = outcome_of(rest)
        residuals = whitened_residuals(outcome.problem, outcome.final)
    tails = heavy_tails(residuals)
    if tails:
        progress(f"running again: the noise of {', '.join(tails)} has heavy tails")
        weighed |= robust_noise(outcome.problem, residuals, tails)
        noise |= {c: noise[c]._replace(freedom=x.freedom) for c, x in tails.items()}
        outcome = outcome_of(outcome.problem.records)
    return replace(outcome, audit=outlying, noise=noise)


def robust_noise(
    problem: AbstractProblem,
    residuals: Mapping[tuple[int, str], np.ndarray],
    tails: Mapping[str, Tails],
) -> dict[tuple[str, str], Noise]:
    """Returns the noise of each trial's file and channel in `tails`, with one value per reading.

    `residuals` are the whitened residuals of a fit. Readings with a large residual get a larger
    noise, so the next fit gives these readings a smaller weight.
    """
    found = {}
    for (i, channel), r in residuals.items():
        if channel in tails:
            noise = problem.noise[i, channel]
            white = noise.white * np.sqrt(tails[channel].variances(r))
            square = tails[channel].mean_square
            found[problem.records[i].trial.file, channel] = noise._replace(
                white=white, mean_square=square
            )
    return found


def growth_of_error(
    rest: AbstractProblem, without: list[np.ndarray], with_it: list[np.ndarray]
) -> Growth:
    """Returns the growth of the error in the held-out trials `rest` by an effect.

    The arguments are the predicted readings (channels, samples) of each trial without and with the
    effect. The whitened sum of squares of a held-out trial is S0 without the effect and S1 with the
    effect. The growth is log(S1/S0). The standard error assumes white noise with the variance S0/n,
    where n is the number of readings. Let d be the sum of the squared changes of the whitened
    readings by the effect. The standard deviation of S1 - S0 is then 2 sqrt(d S0/n), and the
    standard deviation of log(S1/S0) is 2 sqrt(d/(n S0)).
    """
    white = rest.whiteners(without)
    before, after = (rest.residuals(y, white) for y in (without, with_it))
    logs, variances = [], []
    for trial in sorted({i for i, _ in before}):
        keys = [key for key in before if key[0] == trial]
        S0, S1 = (max(total({key: r[key] for key in keys}), 1e-300) for r in (before, after))
        d = sum(float(np.nansum((after[key] - before[key]) ** 2)) for key in keys)
        logs.append(np.log(S1 / S0))
        variances.append(4.0 * d / (sum(len(before[key]) for key in keys) * S0))
    return Growth(float(np.mean(logs)), float(np.sqrt(np.sum(variances)) / len(logs)))


def veto_effects(
    found: Selection,
    problem: AbstractProblem,
    rest: AbstractProblem,
    progress: Callable[[str], None] = lambda text: None,
) -> None:
    """Removes effects that increase the error in the held-out trials from the selection `found`.

    The loop removes the effect with the largest growth and then tests the other effects again.
    `problem` contains the trials of the selection, and `rest` the held-out trials.
    """
    # Without its only effect, the model is the base model, which needs no refit.
    white = problem.whiteners(found.base.predicted) if len(found.effects) > 1 else {}
    refits = Refits(problem, found.entries, white, progress, found.settings)
    while found.effects:
        less = _without_each(refits, found)
        after = rest.predict(found.final.theta)
        growths = {
            n: growth_of_error(rest, rest.predict(fit.theta), after) for n, fit in less.items()
        }
        contradicted = [n for n, x in growths.items() if x.vetoes(found.settings)]
        if not contradicted:
            return
        name = max(contradicted, key=lambda n: growths[n].mean)
        progress(f"removing {name}: it increases the error in the held-out trials")
        found.vetoed[name] = growths[name]
        one = found.effects == [name]
        found.final = found.base if one else refits.fit(less[name].theta, less[name].free)
        found.effects.remove(name)
        round_ = next(r for r in found.rounds if r.chosen == name)
        round_.chosen, round_.equivalent, round_.alternatives = None, [], {}
        round_.taken_out = name


def _without_each(refits: Refits, found: Selection) -> dict[str, Fit]:
    """Returns the fit to the trials of the selection without each effect, where it is possible.

    The fits use the coarse mesh: the veto compares errors that differ by at least 5 %.
    """
    if len(found.effects) == 1:
        return {found.effects[0]: found.base}
    problem, final, groups = refits.problem, found.final, effect_entries(refits.entries)
    refits.progress(f"refitting without each of: {', '.join(found.effects)}")
    along = reading_derivatives(problem, refits.entries, final.theta, final.free)
    J, starts = problem.whitened(along, refits.white), []
    for name in found.effects:
        kept = ~np.isin(final.free, groups[name])
        null = refits.null(final.theta, groups[name])
        own = {key: x[kept] for key, x in J.items()}
        starts.append(FitStart(null, final.free[kept], final.theta, own))
    fits = refits.raced(final, starts, {}, judge=True)
    return {n: x for n, x in zip(found.effects, fits, strict=True) if x.square < FAILED}


def conclude(
    experiment: Experiment,
    names: Sequence[str],
    found: Sequence[Record],
    held: list[int],
    problem_of: Callable[[Sequence[Record]], AbstractProblem],
    base: dict[str, float],
    base_names: Sequence[str],
    progress: Callable[[str], None],
    settings: SelectionSettings = DEFAULT_SETTINGS,
) -> LoopOutcome:
    """Selects effects, tests them on the held-out trials, refits and reaches a verdict."""
    entries = model_parameters(names)
    used = [r for i, r in enumerate(found) if i not in held]
    all_trials = problem_of(found)
    problem = problem_of(used) if held else all_trials
    result = select_effects(
        problem, entries, base_vector(entries, base), progress, base_names, settings
    )
    all_trials = all_trials.with_discrepancies(result.discrepancies)
    problem = problem.with_discrepancies(result.discrepancies)
    held_out = {}
    if held:
        progress("predicting the held-out trials")
        rest = problem_of([found[i] for i in held]).with_discrepancies(result.discrepancies)
        veto_effects(result, problem, rest, progress)
        held_out = channel_errors(
            rest, *(rest.predict(f.theta) for f in (result.base, result.final))
        )
    progress("refitting to all trials")

    # With the same whiteners, the sums of squares of all refits are comparable.
    white = all_trials.whiteners(all_trials.predict(result.final.theta))

    def refit(x: Fit, ranges: Sequence[Parameter]) -> Fit:
        return fit_gauss_newton(
            all_trials, ranges, x.theta, x.free, progress, white, linearised_at=x.linearised_at
        )

    final = widen_ranges(result, refit(result.final, result.entries), refit)
    final = fix_undetermined_shapes(result, final, refit)
    along = derivatives_of_fit(all_trials, result.entries, final)
    final = hausman_check(all_trials, result.entries, final, along)
    final = shift_by_discrepancy(all_trials, final, along)
    final = widen_by_correlation(all_trials, final)
    after = tested_excess(problem, result.final)
    statuses = judge_effects(result, final, after, problem.all_channels)
    verdict = reach_verdict(result, statuses, after)
    return LoopOutcome(
        experiment,
        result.entries,
        verdict,
        result,
        final,
        all_trials,
        channel_errors(problem, result.base.predicted, result.final.predicted),
        held_out,
        after,
        held,
    )
