"""Selects the effects that a model lacks.

Each round scores all candidates, refits the best candidates and chooses at most one of them. A
candidate can be chosen if three conditions hold. Its gain is significant for the number of
candidates. Cross-validation confirms the gain. The candidate changes some channel by more than the
model-discretisation discrepancy that remains with the candidate.

The discrepancy is measured from the residual, which also contains the effects that are still
missing. Each chosen effect can therefore make the measured discrepancy smaller. The model is then
refitted with the smaller discrepancy in the noise.

A chosen effect is removed again if effects that were chosen later make it unnecessary. The reason:
while two effects are missing, a wrong effect that resembles both can have a larger gain than either
missing effect. Source:
Zhang, T. (2011), Adaptive forward-backward greedy algorithm for learning sparse representations,
IEEE Trans. Inf. Theory 57, 4689-4708.

The shape parameters of a chosen effect are fitted too. If the fit of a chosen effect ends at an
edge of a prior range, the range becomes wider (`ranges`). At the end of the selection, shape
parameters that the data do not determine return to their defaults. If an alternative fits clearly
better than a chosen effect, the alternative then replaces this effect (`alternatives`).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from calibration.discrepancy.alternatives import (
    better_alternative,
    equivalent_effects,
    judge_alternatives,
    refit_of_exchange,
)
from calibration.discrepancy.ranges import fix_undetermined_shapes, widen_ranges
from calibration.discrepancy.refits import (
    FitStart,
    Refits,
    ScoringTangents,
    Tangents,
    initial_theta,
    renewed_tangents,
)
from calibration.discrepancy.rounds import (
    Refit,
    Selection,
    SelectionStep,
    agreement,
    can_join,
    effect_entries,
    relative_changes,
    scoring_entries,
)
from calibration.discrepancy.scores import Score, score
from calibration.discrepancy.settings import DEFAULT_SETTINGS, SelectionSettings
from calibration.inference.gauss_newton import Fit, fit_gauss_newton
from calibration.inference.measured_discrepancy import DiscrepancyMeter, fell
from calibration.inference.problem import FAILED, AbstractProblem, ChannelBlock, normal_equations
from calibration.model.extended import BASE, Parameter


def select_effects(
    problem: AbstractProblem,
    entries: Sequence[Parameter],
    theta: np.ndarray,
    progress: Callable[[str], None] = lambda text: None,
    base_names: Sequence[str] = tuple(BASE),
    settings: SelectionSettings = DEFAULT_SETTINGS,
) -> Selection:
    """Selects the effects that the base model with the fitted parameters `base_names` lacks."""
    free = np.array([i for i, p in enumerate(entries) if not p.effect and p.name in base_names])
    progress("calibrating the base model")
    first = fit_gauss_newton(problem.on_coarse_mesh(), entries, theta, free, progress, exact=False)
    refits = Refits(problem, entries, problem.whiteners(first.predicted), progress, settings)
    base = refits.fit(first.theta, free)
    found = Selection(base, base, [], [], settings, entries, discrepancies=problem.discrepancies)
    if problem.mesh_ratio > 1.0 and base.converged:
        coarse = [x[0] for x in problem.coarse([base.theta])]
        meter = DiscrepancyMeter(problem, base.predicted, coarse)
        refits = _with_measured_discrepancies(replace(refits, meter=meter), found)
        found.base = found.final
    for swaps in range(settings.max_swaps + 1):
        refits, tangents = _add(refits, found)
        judge_alternatives(refits, found, tangents)
        swap = better_alternative(found)
        if swap is None or swaps == settings.max_swaps:
            break
        round_, better = swap
        assert round_.chosen is not None
        progress(f"{better} replaces {round_.chosen}")
        found.effects = [better if n == round_.chosen else n for n in found.effects]
        fit = round_.alternatives[better].fit
        found.final = refits.fit(fit.theta, fit.free)
        if better not in {t.name for t in round_.refitted}:
            round_.refitted.append(refit_of_exchange(refits, round_, better, found.final))
        round_.equivalent = [round_.chosen, *(n for n in round_.equivalent if n != better)]
        round_.chosen, round_.replaced = better, round_.chosen
        refits = _widen(refits, found)
        _remove_unnecessary(refits, found, round_)
    return found


def _with_measured_discrepancies(refits: Refits, found: Selection) -> Refits:
    """Measures the discrepancies of the final fit, and refits if one of them decreased."""
    if refits.meter is None:
        return refits
    found.measured = refits.meter(found.final.predicted)
    if not fell(found.measured, refits.problem.discrepancies):
        return refits
    refits.progress("refitting with the measured model-discretisation discrepancy")
    before = refits.problem.discrepancies
    found.discrepancies = {c: min(x.used, before[c]) for c, x in found.measured.items()}
    problem = refits.problem.with_discrepancies(found.discrepancies)
    refits = replace(refits, problem=problem, white=problem.whiteners(found.final.predicted))
    final = found.final
    found.final = refits.fit(final.theta, final.free, linearised_at=final.linearised_at)
    return refits


def _widen(refits: Refits, found: Selection) -> Refits:
    """Returns the refits with wider ranges if a parameter of a selected effect is at an edge."""

    def refit(fit: Fit, entries: Sequence[Parameter]) -> Fit:
        progress("refitting with a wider prior range")
        return replace(refits, entries=entries).fit(fit.theta, fit.free)

    progress = refits.progress
    found.final = widen_ranges(found, refits.freed(found.final, found.effects), refit)
    return replace(refits, entries=found.entries)


def _fix_shapes(refits: Refits, found: Selection) -> None:
    """Fixes the shape parameters that the data do not determine at their defaults."""

    def refit(fit: Fit, entries: Sequence[Parameter]) -> Fit:
        refits.progress("refitting with an undetermined shape parameter at its default")
        return refits.fit(fit.theta, fit.free)

    if any(refits.entries[i].is_shape for i in found.final.free):
        # The least determined parameters need the most exact fit.
        found.final = refits.fit(found.final.theta, found.final.free, exact=True)
    found.final = fix_undetermined_shapes(found, found.final, refit)


def _add(refits: Refits, found: Selection) -> tuple[Refits, Tangents | None]:
    """Adds one effect in each round until no candidate exceeds the naming threshold.

    Returns the refits with the prior ranges of the added effects, and the last whitened tangents.
    """
    settings = refits.settings
    tangents: ScoringTangents | None = None
    while len(found.effects) < settings.max_effects and len(found.rounds) < settings.max_rounds:
        rest = [n for n in effect_entries(refits.entries) if can_join(n, found.effects)]
        if not rest:
            break
        refits.progress(f"round {len(found.rounds) + 1}: scoring {len(rest)} candidates")
        if tangents is None:
            round_, tangents = _round(refits, found.final, rest)
        else:
            scores, _ = _scores(refits, found.final, rest, tangents.white)
            limit = settings.distant_gain_share * settings.min_gain
            near = [s.name for s in scores if s.gain >= limit]
            if near:
                raw = tangents.raw if len(near) <= settings.most_near else None
                tangents = None  # frees the memory before new tangents are computed
                round_, tangents = _round(refits, found.final, rest, raw, near)
            else:
                round_ = SelectionStep(scores)
        found.rounds.append(round_)
        if round_.chosen is None:
            break
        found.effects.append(round_.chosen)
        found.final = next(t.fit for t in round_.refitted if t.name == round_.chosen)
        refits = _widen(refits, found)
        before, refits = refits, _with_measured_discrepancies(refits, found)
        if refits is not before:
            assert tangents is not None
            at, raw = tangents.at, tangents.raw
            tangents = None  # frees the memory before other whiteners are applied
            tangents = ScoringTangents.of(refits, at, raw)
        _remove_unnecessary(refits, found, round_)
    refits = _widen(refits, found)
    _fix_shapes(refits, found)
    return refits, None if tangents is None else tangents.white


def _remove_unnecessary(refits: Refits, found: Selection, by: SelectionStep) -> None:
    """Removes effects that the effect chosen in the round `by` makes unnecessary.

    The equivalence classes of the removed effects are added to the class of the round `by`.
    """
    for name in [n for n in found.effects if n != by.chosen]:
        less = refits.without(found.final, name)
        if less is None:
            continue
        found.final = less
        found.effects.remove(name)
        round_ = next(r for r in found.rounds if r.chosen == name)
        known = (by.chosen, *by.equivalent)
        by.equivalent += [n for n in round_.equivalent if n not in known]
        round_.chosen, round_.equivalent, round_.taken_out = None, [], name


def _scores(
    refits: Refits, current: Fit, rest: Sequence[str], J: Tangents
) -> tuple[list[Score], list[ChannelBlock]]:
    """Returns the scores of the candidates `rest`, best first, and the normal equations."""
    residuals = refits.problem.residuals(current.predicted, refits.white)
    blocks = normal_equations(residuals, J)
    unit, scored = current.inflation, scoring_entries(refits.entries)
    scores = [
        score(n, scored[n], current.free, blocks, unit, len(rest), refits.settings) for n in rest
    ]
    return sorted(scores, key=lambda s: -s.gain), blocks


def _round(
    refits: Refits,
    current: Fit,
    rest: Sequence[str],
    last: list[np.ndarray] | None = None,
    near: Sequence[str] = (),
) -> tuple[SelectionStep, ScoringTangents]:
    """Returns a round of the selection and the tangents of its scores.

    If the tangents `last` of the round before are given, only those of the effects `near` and of
    the fitted parameters are computed again.
    """
    problem, entries, progress = refits.problem, refits.entries, refits.progress
    settings, scored = refits.settings, scoring_entries(refits.entries)
    if last is not None:
        last = renewed_tangents(last, problem, entries, current, near, settings)
    tangents = ScoringTangents.of(refits, current, last)
    scores, blocks = _scores(refits, current, rest, tangents.white)
    candidates = _visible(refits, current, _short_list(scores, refits, scored), tangents)
    round_, starts = SelectionStep(scores), []
    for s in candidates:
        group = effect_entries(entries)[s.name]
        theta = initial_theta(refits, current.theta, group, s.step)
        starts.append(FitStart(theta, np.concatenate([current.free, group]), current.theta))
    if candidates:
        progress(f"refitting with each of: {', '.join(s.name for s in candidates)}")
    fits = refits.raced(current, starts, tangents.white)
    for s, fit in zip(candidates, fits, strict=True):
        if fit.square < FAILED:
            round_.refitted.append(_refit(refits, current, s, fit))
        else:
            progress(f"skipping {s.name}: the start of its refit cannot be simulated")
    best: Refit | None = None
    accepted = [t for t in round_.refitted if t.worth_naming and t.agreement.agreed(settings)]
    for t in sorted(accepted, key=lambda t: -refits.surplus(current, t.fit)):
        if best and refits.surplus(current, t.fit) < refits.surplus(current, best.fit):
            break  # The other candidates are worse already on the coarse mesh.
        progress(f"refitting with {t.name} on the fine mesh")
        s = next(s for s in scores if s.name == t.name)
        fine = _refit(refits, current, s, refits.fit(t.fit.theta, t.fit.free))
        round_.refitted[round_.refitted.index(t)] = fine
        better = best is None or refits.surplus(current, fine.fit) > refits.surplus(
            current, best.fit
        )
        if fine.worth_naming and better:
            best = fine
    if best:
        round_.chosen = best.name
        round_.equivalent = equivalent_effects(best, round_, scored, current, blocks, settings)
    return round_, tangents


def _visible(
    refits: Refits, current: Fit, candidates: Sequence[Score], tangents: ScoringTangents
) -> list[Score]:
    """Returns the candidates that change a channel by more than a share of the discrepancy.

    The changes are predicted from the `tangents`; the share is `naming_share`.
    """
    if not candidates:
        return []
    raw, found = tangents.raw_of([s.name for s in candidates], refits), []
    for s in candidates:
        moved = np.flatnonzero(s.step)
        changed = [
            y + np.tensordot(s.step[moved], x[moved], 1)
            for y, x in zip(current.predicted, raw, strict=True)
        ]
        limits = refits.discrepancies(changed)
        changes = relative_changes(refits.problem, current.predicted, changed)
        if any(x > refits.settings.naming_share * limits[c] for c, x in changes.items()):
            found.append(s)
    return found


def _short_list(scores: list[Score], refits: Refits, scored) -> list[Score]:
    """Returns the candidates to refit, best first.

    There are several kinds of candidates: with a score from tangents or from secants, with or
    without shape parameters. The result contains the best candidates of each kind. Shape parameters
    have their defaults in a score.
    """
    entries, settings = refits.entries, refits.settings
    shaped = {p.effect for p in entries if p.is_shape}
    kinds: dict[tuple[bool, bool], list[Score]] = {}
    for s in scores:
        kind = s.name in shaped, entries[scored[s.name][0]].prior.start is not None
        share = settings.min_score_share_far if any(kind) else settings.min_score_share
        if s.p < settings.false_alarm_p and s.gain > share * scores[0].gain:
            kinds.setdefault(kind, []).append(s)
    best = [s for found in kinds.values() for s in found[: settings.short_list]]
    return sorted(best, key=lambda s: -s.gain)


def _refit(refits: Refits, current: Fit, s: Score, fit: Fit) -> Refit:
    gain = (current.square - fit.square) / fit.inflation
    sizes, more = refits.sizes(current, fit), len(fit.free) - len(current.free)
    named = refits.settings.worth_naming(gain, sizes, refits.discrepancies(fit.predicted), more)
    return Refit(s.name, fit, gain, sizes, agreement(s.left_out, s.held_gains), named)
