"""Which effects the data ask for: fit, score all candidates, refit the best few, keep one, repeat.

A candidate is kept where its gain is beyond chance for the number of candidates tried, the trials
that were left out agree, and what it changes is large enough to be worth a name: larger than what
two correct programs of one model differ by, declared in `noise.DISCREPANCY` before any data.

One that was kept is taken out again where a later one leaves it nothing that is worth a name: while
two causes are missing, a wrong one that resembles one of them and has something of the other can
explain more than either. Source: Zhang, T. (2011), Adaptive forward-backward greedy algorithm for
learning sparse representations, IEEE Trans. Inf. Theory 57, 4689-4708.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.stats import wilcoxon

from calibration.evidence import FAILED, Problem, summed
from calibration.fit import Fit, fit, inverse
from calibration.forward import CHANNELS
from calibration.noise import DISCREPANCY
from calibration.plant import BASE, Parameter
from calibration.trace import Score, alikeness, score
from slider_jax.effects.library import LIBRARY

CHANCE = 1e-3
"""Largest probability of a gain by chance, candidates counted."""
LEAST_GAIN = 20.0
"""Smallest gain of a refitted candidate that counts, in units of the residual's mean square."""
SHORT_LIST = 5
"""Candidates of each kind that are refitted in a round."""
NEARLY = 0.7
"""A candidate is refitted if its score promises so much of what is worth naming."""
AGREE = 2.0
"""Mean over the left-out trials of what `Score.left_out` says, over its standard error, from which
on they agree, beside a gain beyond chance: were it all, 6 % of chance with five trials and 9 % with
three. Factors are averaged, not drops: a trial that is far off has no greater say."""
UNALIKE = 0.07
"""They agree as well where Wilcoxon's signed ranks say so, at this probability of chance: where all
improve, four of four or more, but some by far more than others."""
HALVED = 4
"""Sizes that are tried of a start that cannot be simulated."""
MOST = 3
"""Effects that are added at most."""
ROUNDS = 5
"""Rounds at most, with those whose effect was taken out again."""
SURE = 10.0
"""An effect is not taken out on trial whose loss would be so many times the least gain, as the
linearised model has it."""
ALIKE = 0.95
"""|cos| of two tangents from which on the effects are one class."""
SHARE = 0.5
"""A candidate is refitted if its score is at least so much of the best one's."""
SHARE_AFAR = 0.2
"""The same of one that is scored at a size of its own (`Prior.start`), where less can be told."""


class Agreement(NamedTuple):
    """Whether trials that were left out foresaw a candidate's gain on each other."""

    mean: float
    """Mean of `Score.left_out` over its standard error."""
    chance: float
    """Probability of their signed ranks by chance."""

    @property
    def agreed(self) -> bool:
        return bool(self.mean > AGREE or self.chance < UNALIKE)


def agreement(left_out: np.ndarray) -> Agreement:
    """Of the logarithms `Score.left_out` (trials,)."""
    n = len(left_out)
    spread = float(left_out.std(ddof=1)) / np.sqrt(n) if n > 1 else np.inf
    mean = float(left_out.mean()) / max(spread, 1e-300)
    return Agreement(mean, float(wilcoxon(left_out, alternative="greater").pvalue))


@dataclass(frozen=True)
class Tried:
    """A candidate that was refitted jointly with everything before it."""

    name: str
    fit: Fit
    gain: float
    """Drop of the sum of squares, in units of its own mean square."""
    sizes: dict[str, float]
    """rms of what it changes in each channel, as a share of the channel's rms."""
    agreement: Agreement

    @property
    def worth_naming(self) -> bool:
        return worth_naming(self.gain, self.sizes)


def worth_naming(gain: float, sizes: dict[str, float]) -> bool:
    """Whether an effect of so much gain changes some channel by so much that it is to be named."""
    return gain > LEAST_GAIN and any(sizes[c] > DISCREPANCY[c] for c in sizes)


@dataclass
class Round:
    """One round of the search."""

    scores: list[Score]
    tried: list[Tried] = field(default_factory=list)
    chosen: str | None = None
    alike: list[str] = field(default_factory=list)
    """Names that cannot be told from the chosen one."""
    taken_out: str | None = None
    """What was chosen, until a later round left it nothing to explain."""


@dataclass
class Search:
    """The whole search: the fit of the base model, the rounds, and the last fit."""

    base: Fit
    final: Fit
    effects: list[str]
    rounds: list[Round]


def groups(entries: Sequence[Parameter]) -> dict[str, np.ndarray]:
    """Indices of every effect's parameters."""
    names = dict.fromkeys(p.effect for p in entries if p.effect)
    return {n: np.array([i for i, p in enumerate(entries) if p.effect == n]) for n in names}


def scored(entries: Sequence[Parameter]) -> dict[str, np.ndarray]:
    """Indices of every effect's parameters by which it is scored: those with a start, or all."""
    found = {}
    for name, group in groups(entries).items():
        begun = [i for i in group if entries[i].prior.start is not None]
        found[name] = np.array(begun) if begun else group
    return found


def directions(problem: Problem, entries: Sequence[Parameter], theta: np.ndarray, free: np.ndarray):
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
    channels = [CHANNELS.index(c) for c in problem.channels]
    along = problem.tangents(theta, unit[near])
    lost = ~np.all([np.isfinite(x[:, channels]).all(axis=(1, 2)) for x in along], axis=0)
    for x, tangents in zip(found, along, strict=True):
        x[near] = np.where(lost[:, None, None], 0.0, tangents)
    size = {i: entries[i].prior.start - entries[i].prior.null for i in afar}
    for _ in range(HALVED):
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


def search(
    problem: Problem,
    entries: Sequence[Parameter],
    theta: np.ndarray,
    progress: Callable[[str], None] = lambda text: None,
    base_names: Sequence[str] = tuple(BASE),
) -> Search:
    """Search the effects of `entries` for what the base model lacks on the problem's trials.

    Of the base model the parameters `base_names` are fitted.
    """
    members = groups(entries)
    free = np.array([i for i, p in enumerate(entries) if not p.effect and p.name in base_names])
    progress("calibrating the base model")
    begun = fit(problem, entries, theta, free, progress)
    white = problem.whiteners(begun.predicted)
    base = current = fit(problem, entries, begun.theta, free, progress, white)
    found = Search(base, base, [], [])
    while len(found.effects) < MOST and len(found.rounds) < ROUNDS:
        rest = [n for n in members if _can_join(n, found.effects)]
        if not rest:
            break
        progress(f"round {len(found.rounds) + 1}: scoring {len(rest)} candidates")
        this = _round(problem, entries, current, members, rest, white, progress)
        found.rounds.append(this)
        if this.chosen is None:
            break
        current = next(t.fit for t in this.tried if t.name == this.chosen)
        for name in found.effects.copy():
            less = _without(problem, entries, current, members[name], name, white, progress)
            if less is not None:
                current = less
                _take_out(found, name, this)
        found.effects.append(this.chosen)
        found.final = current
    return found


def _without(problem, entries, current: Fit, group, name: str, white, progress) -> Fit | None:
    """The fit without an effect, if it lacks nothing that is worth a name; else None."""
    null = np.array([entries[i].prior.null for i in group])
    own = np.isin(current.free, group)
    away = (current.theta[group] - null)[np.isin(group, current.free)]
    A = summed(current.blocks)[0]
    loss = away @ np.linalg.pinv(inverse(A)[np.ix_(own, own)]) @ away / current.inflation
    if not loss < SURE * LEAST_GAIN:
        return None
    progress(f"refitting without {name}")
    theta = current.theta.copy()
    theta[group] = null
    less = fit(problem, entries, theta, current.free[~own], progress, white)
    gain = (less.square - current.square) / current.inflation
    sizes = {
        c: _share(less.predicted, current.predicted, CHANNELS.index(c)) for c in problem.channels
    }
    needed = worth_naming(gain, sizes)
    return less if less.converged and not needed else None


def _take_out(found: Search, name: str, by: Round) -> None:
    """`name` is no longer needed beside what the round `by` chose, which takes over its rivals."""
    found.effects.remove(name)
    this = next(r for r in found.rounds if r.chosen == name)
    by.alike += [n for n in this.alike if n not in (by.chosen, *by.alike)]
    this.chosen, this.alike, this.taken_out = None, [], name


def _could_be_named(problem: Problem, current: Fit, everything, step: np.ndarray) -> bool:
    """Whether a score's step changes some channel by nearly what is worth naming."""
    there = [
        y + np.tensordot(step, x, 1) for y, x in zip(current.predicted, everything, strict=True)
    ]
    return any(
        _share(current.predicted, there, CHANNELS.index(c)) > NEARLY * DISCREPANCY[c]
        for c in problem.channels
    )


def _can_join(name: str, effects: list[str]) -> bool:
    taken = {LIBRARY[n].instead for n in effects} - {""}
    return name not in effects and LIBRARY[name].instead not in taken


def _round(problem, entries, current: Fit, members, rest, white, progress) -> Round:
    residuals = problem.residuals(current.predicted, white)
    everything = directions(problem, entries, current.theta, current.free)
    blocks = problem.blocks(residuals, everything, white)
    unit, judged = current.inflation, scored(entries)
    scores = [score(n, judged[n], current.free, blocks, unit, len(rest)) for n in rest]
    scores.sort(key=lambda s: -s.gain)
    this = Round(scores)
    for s in _likely(scores, entries, judged):
        if not _could_be_named(problem, current, everything, s.step):
            continue
        progress(f"refitting with {s.name}")
        tried = _tried(problem, entries, current, members[s.name], s, white, progress)
        if tried is None:
            progress(f"{s.name} cannot be simulated from where its refit would begin: left out")
        else:
            this.tried.append(tried)
    accepted = [t for t in this.tried if t.worth_naming and t.agreement.agreed]
    if not accepted:
        return this
    best = min(accepted, key=lambda t: t.fit.square)
    this.chosen = best.name
    this.alike = _alike(best, this, judged, current, blocks)
    return this


def _likely(scores: list[Score], entries, judged) -> list[Score]:
    """Candidates that are worth a refit, the short list of those near and of those afar."""
    best = scores[0].gain

    def of(share: float, afar: bool) -> list[Score]:
        found = [s for s in scores if s.p < CHANCE and s.gain > share * best]
        kind = [s for s in found if (entries[judged[s.name][0]].prior.start is not None) == afar]
        return kind[:SHORT_LIST]

    return sorted([*of(SHARE, False), *of(SHARE_AFAR, True)], key=lambda s: -s.gain)


def _tried(problem, entries, current: Fit, group, s: Score, white, progress) -> Tried | None:
    start = _begun(entries, current.theta, group, s)
    free = np.concatenate([current.free, group])
    for _ in range(HALVED):
        better = fit(problem, entries, start, free, progress, white)
        if better.square < FAILED:
            break
        start = 0.5 * (start + current.theta)
    else:
        return None
    gain = (current.square - better.square) / better.inflation
    sizes = {
        c: _share(current.predicted, better.predicted, CHANNELS.index(c)) for c in problem.channels
    }
    return Tried(s.name, better, gain, sizes, agreement(s.left_out))


def _begun(entries, theta: np.ndarray, group: np.ndarray, s: Score) -> np.ndarray:
    """Where the refit of a candidate begins: at its starts, or where the score says it is."""
    begun = [i for i in group if entries[i].prior.start is not None]
    if begun:
        theta = theta.copy()
        theta[begun] = [entries[i].prior.start for i in begun]
        return theta
    low, high = np.array([[p.prior.low, p.prior.high] for p in entries]).T
    moved = np.where(s.step == 0.0, theta, np.clip(theta + s.step, low, high))
    still = group[moved[group] == theta[group]]
    moved[still] += 0.02 * (high - low)[still]
    return moved


def _share(before: list[np.ndarray], after: list[np.ndarray], row: int) -> float:
    """rms of the change in a channel over its rms, all trials together."""
    change = np.concatenate([b[row] - a[row] for a, b in zip(before, after, strict=True)])
    signal = np.concatenate([a[row] for a in before])
    return float(np.sqrt(np.mean(change**2) / max(np.mean(signal**2), 1e-300)))


def _alike(best: Tried, this: Round, members, current: Fit, blocks) -> list[str]:
    """Candidates that explain as much, or whose tangents are parallel to the best one's."""
    margin = 0.05 * best.gain
    same = [t.name for t in this.tried if t is not best and t.gain > best.gain - margin]
    refitted = {t.name for t in this.tried}
    parallel = [
        s.name
        for s in this.scores
        if s.name not in refitted
        and s.gain > SHARE * this.scores[0].gain
        and alikeness(members[best.name], members[s.name], current.free, blocks) > ALIKE
    ]
    return same + parallel
