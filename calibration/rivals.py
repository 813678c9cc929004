"""Which effects cannot be told from one that was found.

In the round in which it is found they are those that explain as much, or whose tangents are
parallel to its own. Other causes may be missing then, and what those leave hides what it and a
rival differ by. So at the end, where nothing stands above the noise, every rival is put in its
place and all is fitted again: they are told apart by what makes an effect worth a name.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from calibration.evidence import Block, Problem
from calibration.fit import Fit
from calibration.plant import Parameter
from calibration.refits import Say, White, begun, joined
from calibration.rounds import SHARE, Rival, Round, Search, Tried, groups, sizes_of
from calibration.trace import alikeness
from calibration.verdict import FLOOR, excess
from slider_jax.effects.library import LIBRARY

ALIKE = 0.95
"""|cos| of two tangents from which on the effects are one class."""
AS_MUCH = 0.95
"""Share of an effect's gain from which on a rival explains as much."""
CONTENDS = 0.8
"""Share of it from which on a rival is judged at the end: a wrong effect may have explained
something of another cause as well while that was missing."""


def alike(
    best: Tried,
    this: Round,
    judged: Mapping[str, np.ndarray],
    current: Fit,
    blocks: Sequence[Block],
) -> list[str]:
    """Candidates of a round that explain as much as the best one, or in parallel to it.

    `judged` are the entries by which each effect is scored.
    """
    same = [t.name for t in this.tried if t is not best and t.gain > AS_MUCH * best.gain]
    refitted = {t.name for t in this.tried}
    parallel = [
        s.name
        for s in this.scores
        if s.name not in refitted
        and s.gain > SHARE * this.scores[0].gain
        and alikeness(judged[best.name], judged[s.name], current.free, blocks) > ALIKE
    ]
    return same + parallel


def judge_rivals(
    problem: Problem, entries: Sequence[Parameter], found: Search, white: White, progress: Say
) -> None:
    """Fits every round's rivals in the place of what it chose, and makes its class of those fits.

    A rival that cannot be fitted stays in the class. Where more than noise is left all do.
    """
    if any(x.all > FLOOR for x in excess(problem, found.final).values()):
        return
    for this in found.rounds:
        if this.chosen is None:
            continue
        names = _contenders(this, this.chosen)
        this.rivals = {}
        for name in names:
            progress(f"refitting with {name} in the place of {this.chosen}")
            fit = _instead(problem, entries, found, this, this.chosen, name, white, progress)
            if fit is not None and fit.converged:
                loss = (fit.square - found.final.square) / found.final.inflation
                this.rivals[name] = Rival(fit, loss, sizes_of(problem, fit, found.final))
        unjudged = [n for n in this.alike if n not in this.rivals]
        this.alike = [n for n, x in this.rivals.items() if not x.is_worse] + unjudged


def better(found: Search) -> tuple[Round, str] | None:
    """A round and the rival that is to take the place of what it chose.

    It must have been refitted in that round too, and trials that were left out have agreed on it.
    """
    for this in found.rounds:
        agreed = [t.name for t in this.tried if t.agreement.agreed]
        fits = {n: x.fit.square for n, x in this.rivals.items() if x.is_better and n in agreed}
        if this.chosen is not None and fits:
            return this, min(fits, key=lambda name: fits[name])
    return None


def _contenders(this: Round, chosen: str) -> list[str]:
    gains = {t.name: t.gain for t in this.tried}
    near = [n for n, gain in gains.items() if gain > CONTENDS * gains[chosen] and n != chosen]
    return list(dict.fromkeys([*this.alike, *near]))


def _instead(
    problem: Problem,
    entries: Sequence[Parameter],
    found: Search,
    this: Round,
    chosen: str,
    rival: str,
    white: White,
    progress: Say,
) -> Fit | None:
    """The last fit with a rival, which may be in it already, in the place of what was chosen.

    None where another effect has taken the place of the rival's law, or nothing can be simulated.
    """
    laws = {LIBRARY[n].instead for n in found.effects if n not in (chosen, rival)} - {""}
    if LIBRARY[rival].instead in laws:
        return None
    members, final = groups(entries), found.final
    group, place = members[rival], members[chosen]
    theta = final.theta.copy()
    theta[place] = [entries[i].prior.null for i in place]
    rest = final.free[~np.isin(final.free, place)]
    if rival in found.effects:
        return joined(problem, entries, theta, theta, rest, white, progress)
    rounds = [this, *found.rounds]
    refits = [t.fit for r in rounds for t in r.tried if t.name == rival]
    start = theta.copy()
    if refits:
        start[group] = refits[0].theta[group]
    else:
        step = next(s.step for r in rounds for s in r.scores if s.name == rival)
        own = np.isin(np.arange(len(theta)), group)
        start = begun(entries, theta, group, np.where(own, step, 0.0))
    free = np.concatenate([rest, group])
    return joined(problem, entries, theta, start, free, white, progress)
