"""Compares alternative effects with a chosen effect.

The alternatives of a chosen effect are candidates of the same round with nearly the same gain or
with parallel tangents. During this round, another effect that is still missing can hide differences
between these candidates. The alternatives are therefore compared again after the selection. The
missing effect can also hide the true effect from the list of the round. All candidates are
therefore scored again in place of each chosen effect, with the other chosen effects in the model,
and the best candidates join the alternatives. Each alternative is substituted for the chosen
effect, and all parameters are refitted. An alternative replaces the chosen effect if its fit is
better by at least the naming threshold, and if cross-validation with the other effects in the model
confirms it. An alternative is excluded if its fit is worse by at least the naming threshold. All
other alternatives form the equivalence class. While a residual exceeds the noise floor, an effect
may still be missing. An alternative is then excluded only if the model already contains it, and
needs the chosen effect too.

Source of the second comparison: sequential replacement, Miller, A. J. (1984), Selection of subsets
of regression variables, J. R. Stat. Soc. A 147, 389-425.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from calibration.discrepancy.refits import (
    FitStart,
    Refits,
    Tangents,
    effect_tangents,
    initial_theta,
)
from calibration.discrepancy.rounds import (
    Agreement,
    Alternative,
    Refit,
    Selection,
    SelectionStep,
    agreement,
    can_join,
    effect_entries,
    relative_changes,
    scoring_entries,
)
from calibration.discrepancy.scores import blocks_at_null, score, tangent_cosine
from calibration.discrepancy.settings import SelectionSettings
from calibration.inference.gauss_newton import Fit
from calibration.inference.goodness import tested_excess
from calibration.inference.problem import (
    FAILED,
    ChannelBlock,
    normal_equations,
    products,
    summed,
    total,
)
from slider_jax.effects.library import LIBRARY


def equivalent_effects(
    best: Refit,
    round_: SelectionStep,
    scored: Mapping[str, np.ndarray],
    current: Fit,
    blocks: Sequence[ChannelBlock],
    settings: SelectionSettings,
) -> list[str]:
    """Returns candidates with nearly the gain of `best`, or with tangents parallel to its tangents.

    `scored` maps each effect to the indices of the parameters from which its score is computed.
    """
    A, _ = summed(blocks)
    enough = settings.equal_gain_share * best.gain
    same = [t.name for t in round_.refitted if t.name != best.name and t.gain > enough]
    refitted = {t.name for t in round_.refitted}
    parallel = [
        s.name
        for s in round_.scores
        if s.name not in refitted
        and s.gain > settings.min_score_share * round_.scores[0].gain
        and tangent_cosine(A, scored[best.name], scored[s.name], current.free)
        > settings.parallel_cosine
    ]
    return same + parallel


def exchanges(refits: Refits, found: Selection, J: Tangents) -> dict[str, dict[str, np.ndarray]]:
    """Returns for each chosen effect the candidates that may replace it.

    The candidates and the chosen effect are scored by the residual without the chosen effect, but
    with all others. `J` are whitened tangents of all candidates, also of an earlier round. A step
    is the change of the parameter vector that the score predicts. The result lacks an effect if the
    model without it cannot be simulated. It is empty for fewer than two effects, because the rounds
    then made the same comparison.
    """
    if len(found.effects) < 2:
        return {}
    problem, settings, final = refits.problem, refits.settings, found.final
    groups, scored = effect_entries(refits.entries), scoring_entries(refits.entries)
    nulls = [refits.null(final.theta, groups[name]) for name in found.effects]
    coarse = problem.coarse([final.theta, *nulls])
    blocks = normal_equations(problem.residuals(final.predicted, refits.white), J)
    proposed: dict[str, dict[str, np.ndarray]] = {}
    for k, name in enumerate(found.effects, 1):
        predicted = [y + x[k] - x[0] for y, x in zip(final.predicted, coarse, strict=True)]
        left = problem.residuals(predicted, refits.white)
        if total(left) >= FAILED:
            continue
        without = [
            x._replace(b=products(J[x.trial, x.channel], r), c=float(r @ r))
            for x, r in zip(blocks, left.values(), strict=True)
        ]
        others = [n for n in found.effects if n != name]
        rest = final.free[~np.isin(final.free, groups[name])]
        possible = [n for n in groups if can_join(n, others)]
        scores = [
            score(n, scored[n], rest, without, final.inflation, len(possible), settings)
            for n in possible
        ]
        best = sorted(scores, key=lambda s: -s.gain)[: settings.short_list]
        least = settings.contender_gain_share * best[0].gain
        proposed[name] = {s.name: s.step for s in best if s.gain > least and s.name != name}
    return proposed


def judge_alternatives(refits: Refits, found: Selection, J: Tangents | None = None) -> None:
    """Substitutes each alternative for its round's chosen effect and updates the equivalence class.

    `J` are the last tangents that were computed, also at an earlier fit. They are used if they
    contain all parameters that the final fit keeps. An alternative that cannot be fitted remains in
    the class if it was in the class before. If a residual exceeds the noise floor, a class loses
    only effects that the model also contains.
    """
    settings = refits.settings
    for round_ in found.rounds:
        round_.alternatives, round_.exchanged = {}, []
    problem, final = refits.problem, found.final
    contenders = [(round_, _contenders(round_, settings)) for round_ in found.rounds]
    pairs = []
    if len(found.effects) > 1 or any(near for _, near in contenders):
        J = _tangents_without_each(refits, found, J)
        proposed = exchanges(refits, found, J)
        for round_, near in contenders:
            steps = proposed.get(round_.chosen or "", {})
            round_.exchanged = list(steps)
            for name in dict.fromkeys([*near, *steps]):
                start = _substitution(refits, found, round_, name, steps)
                if start is not None:
                    pairs.append((round_, name, start))
    if J is not None and pairs:
        swaps = ", ".join(f"{name} instead of {round_.chosen}" for round_, name, _ in pairs)
        refits.progress(f"refitting with {swaps}")
        fits = refits.raced(final, [start for *_, start in pairs], J, judge=True)
        for (round_, name, _), fit in zip(pairs, fits, strict=True):
            if fit.converged:
                loss = (fit.square - final.square) / final.inflation
                fewer = len(final.free) - len(fit.free)
                round_.alternatives[name] = Alternative(
                    fit,
                    loss,
                    refits.sizes(fit, final),
                    problem.discrepancies,
                    fewer,
                    _agreement(refits, found, name, fit),
                )
    above = any(x.above(settings.noise_floor) for x in tested_excess(problem, final).values())
    for round_ in found.rounds:
        excluded = {n for n, x in round_.alternatives.items() if x.is_excluded(settings)}
        if above:
            # The model already contains these alternatives, and needs the chosen effect too.
            excluded &= set(found.effects)
            judged: list[str] = []
        else:
            judged = list(round_.alternatives)
        names = dict.fromkeys([*judged, *round_.equivalent])
        round_.equivalent = [n for n in names if n not in excluded]


def _tangents_without_each(refits: Refits, found: Selection, J: Tangents | None) -> Tangents:
    """Returns `J` if it contains the parameters that remain without any one of the chosen effects.

    Otherwise, the result are new tangents at the final fit.
    """
    groups, final = effect_entries(refits.entries), found.final
    kept = {i for name in found.effects for i in final.free if i not in groups[name]}
    if J is not None and all(any(x[i].any() for x in J.values()) for i in kept):
        return J
    problem = refits.problem
    tangents = effect_tangents(problem, refits.entries, final.theta, final.free, refits.settings)
    return problem.whitened(tangents, refits.white, in_place=True)


def better_alternative(found: Selection) -> tuple[SelectionStep, str] | None:
    """Returns a round and an alternative that fits better than the round's chosen effect, or None.

    The round must have refitted the alternative, or an exchange must have found it. If there are
    several, the result is the best.
    """
    fits = {
        (number, name): x.fit.square
        for number, round_ in enumerate(found.rounds)
        for name, x in round_.alternatives.items()
        if x.is_better(found.settings)
        and name in {*(t.name for t in round_.refitted), *round_.exchanged}
    }
    if not fits:
        return None
    number, name = min(fits, key=lambda key: fits[key])
    return found.rounds[number], name


def refit_of_exchange(refits: Refits, round_: SelectionStep, name: str, fit: Fit) -> Refit:
    """Returns the record of an effect that replaces a round's chosen effect by an exchange.

    `fit` is the final fit with the effect. The gain is that of the chosen effect, minus the loss by
    the exchange.
    """
    x = round_.alternatives[name]
    before = next(t for t in round_.refitted if t.name == round_.chosen)
    null = refits.null(fit.theta, effect_entries(refits.entries)[name])
    sizes = relative_changes(refits.problem, refits.problem.predict(null), fit.predicted)
    assert x.agreement is not None
    return Refit(name, fit, before.gain - x.loss, sizes, x.agreement, True)


def _agreement(refits: Refits, found: Selection, name: str, fit: Fit) -> Agreement | None:
    """Returns the cross-validation of the effect `name` in its `fit` with all other effects."""
    if name in found.effects:
        return None
    own = np.isin(fit.free, effect_entries(refits.entries)[name])
    group, free = np.flatnonzero(own), np.flatnonzero(~own)
    strengths = [i for i in fit.free[group] if not refits.entries[i].is_shape]
    null = refits.null(fit.theta, np.array(strengths))
    blocks = blocks_at_null(fit.blocks, group, (fit.theta - null)[fit.free[group]])
    x = score(name, group, free, blocks, fit.inflation, 1, refits.settings)
    return agreement(x.left_out, x.held_gains)


def _contenders(round_: SelectionStep, settings: SelectionSettings) -> list[str]:
    if round_.chosen is None:
        return []
    gains = {t.name: t.gain for t in round_.refitted}
    least = settings.contender_gain_share * gains[round_.chosen]
    near = [n for n, gain in gains.items() if gain > least and n != round_.chosen]
    return list(dict.fromkeys([*round_.equivalent, *near]))


def _substitution(
    refits: Refits,
    found: Selection,
    round_: SelectionStep,
    alternative: str,
    steps: Mapping[str, np.ndarray],
) -> FitStart | None:
    """Returns the start of a fit with an alternative substituted for a round's chosen effect.

    The final fit may already contain the alternative. Returns None if another effect in the fit
    replaces the same law of the base model. `steps` are those of the `exchanges` of the round; the
    start of an alternative that was refitted before is its refit.
    """
    assert round_.chosen is not None
    others = [n for n in found.effects if n not in (round_.chosen, alternative)]
    if LIBRARY[alternative].replaces_law in {LIBRARY[n].replaces_law for n in others} - {""}:
        return None
    indices, final = effect_entries(refits.entries), found.final
    group, place = indices[alternative], indices[round_.chosen]
    theta = refits.null(final.theta, place)
    rest = final.free[~np.isin(final.free, place)]
    if alternative in found.effects:
        return FitStart(theta, rest, theta)
    rounds = [round_, *found.rounds]
    fits = [t.fit for r in rounds for t in r.refitted if t.name == alternative]
    start = theta.copy()
    if fits:
        start[group] = fits[0].theta[group]
    else:
        scores = (s.step for r in rounds for s in r.scores if s.name == alternative)
        step = steps[alternative] if alternative in steps else next(scores)
        own = np.isin(np.arange(len(theta)), group)
        start = initial_theta(refits, theta, group, np.where(own, step, 0.0))
    return FitStart(start, np.concatenate([rest, group]), theta)
