"""Which effects the data ask for: fit, score all candidates, refit the best few, keep one, repeat.

A candidate is kept where its gain is beyond chance for the number of candidates tried, the trials
that were left out agree, and what it changes is large enough to be worth a name: larger than what
two correct programs of one model differ by, declared in `slider_jax.channels` before any data.

One that was kept is taken out again where a later one leaves it nothing that is worth a name: while
two causes are missing, a wrong one that resembles one of them and has something of the other can
explain more than either. Source: Zhang, T. (2011), Adaptive forward-backward greedy algorithm for
learning sparse representations, IEEE Trans. Inf. Theory 57, 4689-4708.

At the end rivals are put in its place (`rivals`): one that fits better stays there.
"""

from collections.abc import Callable, Sequence

import numpy as np

from calibration.discrepancy.alternatives import (
    better_alternative,
    equivalent_effects,
    judge_alternatives,
)
from calibration.discrepancy.refits import HALVINGS, Refits, initial_theta
from calibration.discrepancy.rounds import (
    SHARE,
    Refit,
    Selection,
    SelectionStep,
    agreement,
    groups,
    relative_changes,
    scored,
)
from calibration.discrepancy.scores import Score, score
from calibration.inference.gauss_newton import Fit, fit_gauss_newton
from calibration.inference.problem import AbstractProblem
from calibration.model.extended import BASE, Parameter
from slider_jax.channels import CHANNELS, row_of
from slider_jax.effects.library import LIBRARY

CHANCE = 1e-3
"""Largest probability of a gain by chance, candidates counted."""
SHORT_LIST = 5
"""Candidates of each kind that are refitted in a round."""
SHARE_AFAR = 0.2
"""As `SHARE`, of a candidate that is scored at a size of its own (`Prior.start`), where less can be
told."""
NEARLY = 0.7
"""A candidate is refitted if its score promises so much of what is worth naming."""
MOST = 3
"""Effects that are added at most."""
ROUNDS = 5
"""Rounds at most, with those whose effect was taken out again."""
SWAPS = 2
"""Times that a rival takes the place of what was chosen, at most."""


def directions(
    problem: AbstractProblem, entries: Sequence[Parameter], theta: np.ndarray, free: np.ndarray
):
    """What each parameter does to each trial (parameters, 5, samples), per unit.

    Tangents at `theta`; of a parameter with a start that is at its null, the change up to there,
    halved while it cannot be simulated. Zero for the other parameters of such an effect, and along
    what has no finite tangent.
    """
    judged = np.unique(np.concatenate([free, *scored(entries).values()]))
    afar = [i for i in judged if entries[i].prior.start is not None and i not in free]
    near = [i for i in judged if i not in afar]
    found = [np.zeros((len(theta), *r.values.shape)) for r in problem.records]
    unit = np.eye(len(theta))
    channels = [row_of(c) for c in problem.channels]
    along = problem.tangents(theta, unit[near])
    lost = ~np.all([np.isfinite(x[:, channels]).all(axis=(1, 2)) for x in along], axis=0)
    for x, tangents in zip(found, along, strict=True):
        x[near] = np.where(lost[:, None, None], 0.0, tangents)
    size = {i: entries[i].prior.start - entries[i].prior.null for i in afar}
    for _ in range(HALVINGS):
        if not size:
            break
        order = list(size)
        changes = problem.secants(theta, [theta + size[i] * unit[i] for i in order])
        for row, i in enumerate(order):
            if all(np.isfinite(c[row][channels]).all() for c in changes):
                for x, c in zip(found, changes, strict=True):
                    x[i] = c[row] / size[i]
                del size[i]
            else:
                size[i] *= 0.5
    return found


def select_effects(
    problem: AbstractProblem,
    entries: Sequence[Parameter],
    theta: np.ndarray,
    progress: Callable[[str], None] = lambda text: None,
    base_names: Sequence[str] = tuple(BASE),
) -> Selection:
    """Search the effects of `entries` for what the base model lacks on the problem's trials.

    Of the base model the parameters `base_names` are fitted.
    """
    free = np.array([i for i, p in enumerate(entries) if not p.effect and p.name in base_names])
    progress("calibrating the base model")
    first = fit_gauss_newton(problem, entries, theta, free, progress)
    white = problem.whiteners(first.predicted)
    base = fit_gauss_newton(problem, entries, first.theta, free, progress, white)
    refits = Refits(problem, entries, white, progress)
    found = Selection(base, base, [], [])
    for swaps in range(SWAPS + 1):
        _add(refits, found)
        judge_alternatives(refits, found)
        swap = better_alternative(found)
        if swap is None or swaps == SWAPS:
            break
        this, rival = swap
        assert this.chosen is not None
        progress(f"{rival} takes the place of {this.chosen}")
        found.effects = [rival if n == this.chosen else n for n in found.effects]
        found.final = this.rivals[rival].fit
        this.alike = [this.chosen, *(n for n in this.alike if n != rival)]
        this.chosen, this.replaced = rival, this.chosen
        _take_out_needless(refits, found, this)
    return found


def _add(refits: Refits, found: Selection) -> None:
    """Effects, one a round, until there is none to be named."""
    while len(found.effects) < MOST and len(found.rounds) < ROUNDS:
        rest = [n for n in groups(refits.entries) if _can_join(n, found.effects)]
        if not rest:
            break
        refits.progress(f"round {len(found.rounds) + 1}: scoring {len(rest)} candidates")
        this = _round(refits, found.final, rest)
        found.rounds.append(this)
        if this.chosen is None:
            break
        found.effects.append(this.chosen)
        found.final = next(t.fit for t in this.tried if t.name == this.chosen)
        _take_out_needless(refits, found, this)


def _take_out_needless(refits: Refits, found: Selection, by: SelectionStep) -> None:
    """What is no longer needed beside what the round `by` chose, which takes over its rivals."""
    for name in [n for n in found.effects if n != by.chosen]:
        less = refits.without(found.final, name)
        if less is None:
            continue
        found.final = less
        found.effects.remove(name)
        this = next(r for r in found.rounds if r.chosen == name)
        by.alike += [n for n in this.alike if n not in (by.chosen, *by.alike)]
        this.chosen, this.alike, this.taken_out = None, [], name


def _could_be_named(problem: AbstractProblem, current: Fit, everything, step: np.ndarray) -> bool:
    """Whether a score's step changes some channel by nearly what is worth naming."""
    there = [
        y + np.tensordot(step, x, 1) for y, x in zip(current.predicted, everything, strict=True)
    ]
    changes = relative_changes(problem.channels, current.predicted, there)
    return any(change > NEARLY * CHANNELS[c].discrepancy for c, change in changes.items())


def _can_join(name: str, effects: list[str]) -> bool:
    taken = {LIBRARY[n].replaces_law for n in effects} - {""}
    return name not in effects and LIBRARY[name].replaces_law not in taken


def _round(refits: Refits, current: Fit, rest: Sequence[str]) -> SelectionStep:
    problem, entries, progress = refits.problem, refits.entries, refits.progress
    residuals = problem.residuals(current.predicted, refits.white)
    everything = directions(problem, entries, current.theta, current.free)
    blocks = problem.blocks(residuals, everything, refits.white)
    unit, judged = current.inflation, scored(entries)
    scores = [score(n, judged[n], current.free, blocks, unit, len(rest)) for n in rest]
    scores.sort(key=lambda s: -s.gain)
    this = SelectionStep(scores)
    for s in _likely(scores, entries, judged):
        if not _could_be_named(problem, current, everything, s.step):
            continue
        progress(f"refitting with {s.name}")
        tried = _tried(refits, current, s)
        if tried is None:
            progress(f"{s.name} cannot be simulated from where its refit would begin: left out")
        else:
            this.tried.append(tried)
    accepted = [t for t in this.tried if t.worth_naming and t.agreement.agreed]
    if not accepted:
        return this
    best = min(accepted, key=lambda t: t.fit.square)
    this.chosen = best.name
    this.alike = equivalent_effects(best, this, judged, current, blocks)
    return this


def _likely(scores: list[Score], entries, judged) -> list[Score]:
    """Candidates that are worth a refit, the short list of those near and of those afar."""
    best = scores[0].gain

    def of(least: float, afar: bool) -> list[Score]:
        found = [s for s in scores if s.p < CHANCE and s.gain > least * best]
        kind = [s for s in found if (entries[judged[s.name][0]].prior.start is not None) == afar]
        return kind[:SHORT_LIST]

    return sorted([*of(SHARE, False), *of(SHARE_AFAR, True)], key=lambda s: -s.gain)


def _tried(refits: Refits, current: Fit, s: Score) -> Refit | None:
    group = groups(refits.entries)[s.name]
    start = initial_theta(refits.entries, current.theta, group, s.step)
    refitted = refits.joined(current.theta, start, np.concatenate([current.free, group]))
    if refitted is None:
        return None
    gain = (current.square - refitted.square) / refitted.inflation
    sizes = refits.sizes(current, refitted)
    return Refit(s.name, refitted, gain, sizes, agreement(s.left_out))
