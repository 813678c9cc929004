"""Which effects the data ask for: fit, score all candidates, refit the best few, keep one, repeat.

A candidate is kept where its gain is beyond chance for the number of candidates tried, the trials
that were left out agree, and what it changes is large enough to be worth a name: larger than what
two correct programs of one model differ by, declared in `noise.DISCREPANCY` before any data.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from calibration.evidence import Problem
from calibration.fit import Fit, fit
from calibration.forward import CHANNELS
from calibration.noise import DISCREPANCY
from calibration.plant import Parameter
from calibration.trace import Score, alikeness, score

CHANCE = 1e-3
"""Largest probability of a gain by chance, candidates counted."""
LEAST_GAIN = 20.0
"""Smallest gain of a refitted candidate that counts, in units of the residual's mean square."""
SHORT_LIST = 5
"""Candidates that are refitted in a round."""
MOST = 3
"""Effects that are added at most."""
ALIKE = 0.95
"""|cos| of two tangents from which on the effects are one class."""
SHARE = 0.5
"""A candidate is refitted if its score is at least so much of the best one's."""


@dataclass(frozen=True)
class Tried:
    """A candidate that was refitted jointly with everything before it."""

    name: str
    fit: Fit
    gain: float
    """Drop of the sum of squares, in units of its own mean square."""
    sizes: dict[str, float]
    """rms of what it changes in each channel, as a share of the channel's rms."""
    agree: float
    """Mean of the gains of left-out trials over their standard error."""

    @property
    def worth_naming(self) -> bool:
        large = any(self.sizes[c] > DISCREPANCY[c] for c in self.sizes)
        return large and self.gain > LEAST_GAIN


@dataclass
class Round:
    """One round of the search."""

    scores: list[Score]
    tried: list[Tried] = field(default_factory=list)
    chosen: str | None = None
    alike: list[str] = field(default_factory=list)
    """Names that cannot be told from the chosen one."""


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


def search(
    problem: Problem,
    entries: Sequence[Parameter],
    theta: np.ndarray,
    progress: Callable[[str], None] = lambda text: None,
) -> Search:
    """Search the effects of `entries` for what the base model lacks on the problem's trials."""
    members = groups(entries)
    free = np.array([i for i, p in enumerate(entries) if not p.effect])
    progress("calibrating the base model")
    begun = fit(problem, entries, theta, free, progress)
    white = problem.whiteners(begun.predicted)
    base = current = fit(problem, entries, begun.theta, free, progress, white)
    found = Search(base, base, [], [])
    for number in range(MOST):
        rest = [n for n in members if n not in found.effects]
        progress(f"round {number + 1}: scoring {len(rest)} candidates")
        this = _round(problem, entries, current, members, rest, white, progress)
        found.rounds.append(this)
        if this.chosen is None:
            break
        current = next(t.fit for t in this.tried if t.name == this.chosen)
        found.effects.append(this.chosen)
        found.final = current
    return found


def _round(problem, entries, current: Fit, members, rest, white, progress) -> Round:
    residuals = problem.residuals(current.predicted, white)
    everything = problem.tangents(current.theta, np.eye(len(entries)))
    blocks = problem.blocks(residuals, everything, white)
    unit = current.inflation
    scores = [score(n, members[n], current.free, blocks, unit, len(rest)) for n in rest]
    scores.sort(key=lambda s: -s.gain)
    this = Round(scores)
    likely = [s for s in scores if s.p < CHANCE and s.gain > SHARE * scores[0].gain]
    for s in likely[:SHORT_LIST]:
        progress(f"refitting with {s.name}")
        this.tried.append(_tried(problem, entries, current, members[s.name], s, white, progress))
    accepted = [t for t in this.tried if t.worth_naming and t.agree > 1.0]
    if not accepted:
        return this
    best = min(accepted, key=lambda t: t.fit.square)
    this.chosen = best.name
    this.alike = _alike(best, this, members, current, blocks)
    return this


def _tried(problem, entries, current: Fit, group, s: Score, white, progress) -> Tried:
    start = current.theta.copy()
    low = np.array([entries[i].prior.low for i in group])
    high = np.array([entries[i].prior.high for i in group])
    start[group] = np.clip(start[group] + s.estimate, low, high)
    inside = start[group] == current.theta[group]
    start[group] = np.where(inside, start[group] + 0.02 * (high - low), start[group])
    free = np.concatenate([current.free, group])
    better = fit(problem, entries, start, free, progress, white)
    gain = (current.square - better.square) / better.inflation
    sizes = {
        c: _share(current.predicted, better.predicted, CHANNELS.index(c)) for c in problem.channels
    }
    spread = s.left_out.std(ddof=1) / np.sqrt(len(s.left_out)) if len(s.left_out) > 1 else np.inf
    return Tried(s.name, better, gain, sizes, float(s.left_out.mean() / max(spread, 1e-300)))


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
