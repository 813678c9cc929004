"""Which effects cannot be told from one that was found.

In the round in which it is found they are those that explain as much, or whose tangents are
parallel to its own. Other causes may be missing then, and what those leave hides what it and a
rival differ by. So at the end, where nothing stands above the noise, every rival is put in its
place and all is fitted again: they are told apart by what makes an effect worth a name.
"""

from collections.abc import Sequence

import numpy as np

from calibration.evidence import Problem
from calibration.fit import Fit
from calibration.plant import Parameter
from calibration.refits import Say, White, begun, joined
from calibration.rounds import SHARE, Round, Search, Tried, groups, sizes_of, worth_naming
from calibration.trace import alikeness
from calibration.verdict import FLOOR
from slider_jax.effects.library import LIBRARY

ALIKE = 0.95
"""|cos| of two tangents from which on the effects are one class."""
AS_MUCH = 0.95
"""Share of an effect's gain from which on a rival explains as much."""
CONTENDS = 0.8
"""Share of it from which on a rival is judged again: a wrong effect may have explained something of
another cause as well while that was missing."""


def alike(best: Tried, this: Round, members, current: Fit, blocks) -> list[str]:
    """Candidates of a round that explain as much as the best one, or in parallel to it."""
    same = [t.name for t in this.tried if t is not best and t.gain > AS_MUCH * best.gain]
    refitted = {t.name for t in this.tried}
    parallel = [
        s.name
        for s in this.scores
        if s.name not in refitted
        and s.gain > SHARE * this.scores[0].gain
        and alikeness(members[best.name], members[s.name], current.free, blocks) > ALIKE
    ]
    return same + parallel


def judged_again(
    problem: Problem, entries: Sequence[Parameter], found: Search, white: White, progress: Say
) -> list[Round]:
    """Judges every round's rivals at the last fit; the rounds whose effect gave way to a rival.

    A rival that cannot be fitted stays one. Where more than noise is left all do.
    """
    changed = []
    for this in found.rounds:
        rivals = _contenders(this)
        if this.chosen is None or not rivals:
            continue
        fits = {this.chosen: found.final}
        for rival in rivals:
            if _fits_in(rival, this.chosen, found.effects):
                progress(f"refitting with {rival} in the place of {this.chosen}")
                refit = _instead(problem, entries, found, this, rival, white, progress)
                if refit is not None and refit.converged:
                    fits[rival] = refit
        this.rivals = {n: fits[n] for n in rivals if n in fits}
        if not _at_floor(problem, found.final, white):
            continue
        known = [t.name for t in this.tried if t.name in fits]
        best = min(known, key=lambda name: fits[name].square)
        if not _told_apart(problem, fits[best], found.final):
            best = this.chosen
        others = [n for n in (this.chosen, *rivals) if n != best]
        apart = [n for n in others if n in fits and _told_apart(problem, fits[best], fits[n])]
        unjudged = [n for n in rivals if n not in fits and n not in this.alike]
        this.alike = [n for n in others if n not in (*apart, *unjudged)]
        this.rivals = {n: fits[n] for n in others if n in fits}
        if best != this.chosen:
            found.effects[found.effects.index(this.chosen)] = best
            this.chosen, found.final = best, fits[best]
            changed.append(this)
    return changed


def _contenders(this: Round) -> list[str]:
    """Names that are judged again beside what the round chose."""
    if this.chosen is None:
        return []
    gains = {t.name: t.gain for t in this.tried}
    least = CONTENDS * gains.get(this.chosen, np.inf)
    near = [n for n, gain in gains.items() if gain > least and n != this.chosen]
    return list(dict.fromkeys([*this.alike, *near]))


def _at_floor(problem: Problem, final: Fit, white: White) -> bool:
    """Whether no channel's mean square stands above the noise's."""
    residuals = problem.residuals(final.predicted, white)
    for channel in problem.channels:
        each = [r for (_, name), r in residuals.items() if name == channel]
        if each and np.mean(np.concatenate(each) ** 2) > FLOOR:
            return False
    return True


def _fits_in(rival: str, chosen: str, effects: Sequence[str]) -> bool:
    """Whether a rival may stand in the place of `chosen` beside the other effects."""
    laws = {LIBRARY[n].instead for n in effects if n not in (chosen, rival)} - {""}
    return LIBRARY[rival].instead not in laws


def _instead(
    problem, entries, found: Search, this: Round, rival: str, white: White, progress: Say
) -> Fit | None:
    """The last fit with a rival, which may be in it already, in the place of what a round chose."""
    members, final = groups(entries), found.final
    group, place = members[rival], members[str(this.chosen)]
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


def _told_apart(problem: Problem, better: Fit, worse: Fit) -> bool:
    gain = (worse.square - better.square) / better.inflation
    return worth_naming(gain, sizes_of(problem, worse, better))
