"""Which effects cannot be told from one that was found.

In the round in which it is found they are those that explain as much, or whose tangents are
parallel to its own. Other causes may be missing then, and what those leave hides what it and a
rival differ by. So at the end, where nothing stands above the noise, every rival is put in its
place and all is fitted again: they are told apart by what makes an effect worth a name.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from calibration.discrepancy.refits import Refits, initial_theta
from calibration.discrepancy.rounds import (
    SHARE,
    Alternative,
    Refit,
    Selection,
    SelectionStep,
    groups,
)
from calibration.discrepancy.scores import tangent_cosine
from calibration.inference.gauss_newton import Fit
from calibration.inference.goodness import FLOOR, excess
from calibration.inference.problem import ChannelBlock
from slider_jax.effects.library import LIBRARY

ALIKE = 0.95
"""|cos| of two tangents from which on the effects are one class."""
AS_MUCH = 0.95
"""Share of an effect's gain from which on a rival explains as much."""
CONTENDS = 0.8
"""Share of it from which on a rival is judged at the end: a wrong effect may have explained
something of another cause as well while that was missing."""


def equivalent_effects(
    best: Refit,
    this: SelectionStep,
    judged: Mapping[str, np.ndarray],
    current: Fit,
    blocks: Sequence[ChannelBlock],
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
        and tangent_cosine(judged[best.name], judged[s.name], current.free, blocks) > ALIKE
    ]
    return same + parallel


def judge_alternatives(refits: Refits, found: Selection) -> None:
    """Fits every round's rivals in the place of what it chose, and makes its class of those fits.

    One that cannot be fitted stays what the round had it for. Where more than noise is left all do.
    """
    for this in found.rounds:
        this.rivals = {}
    if any(x.all > FLOOR for x in excess(refits.problem, found.final).values()):
        return
    for this in found.rounds:
        for name in _contenders(this):
            refits.progress(f"refitting with {name} in the place of {this.chosen}")
            fit = _instead(refits, found, this, name)
            if fit is not None and fit.converged:
                loss = (fit.square - found.final.square) / found.final.inflation
                this.rivals[name] = Alternative(fit, loss, refits.sizes(fit, found.final))
        unjudged = [n for n in this.alike if n not in this.rivals]
        this.alike = [n for n, x in this.rivals.items() if not x.is_worse] + unjudged


def better_alternative(found: Selection) -> tuple[SelectionStep, str] | None:
    """A round and the rival that is to take the place of what it chose.

    It must have been refitted in that round too, and trials that were left out have agreed on it.
    """
    for this in found.rounds:
        agreed = {t.name for t in this.tried if t.agreement.agreed}.difference(found.effects)
        fits = {n: x.fit.square for n, x in this.rivals.items() if x.is_better and n in agreed}
        if fits:
            return this, min(fits, key=lambda name: fits[name])
    return None


def _contenders(this: SelectionStep) -> list[str]:
    if this.chosen is None:
        return []
    gains = {t.name: t.gain for t in this.tried}
    least = CONTENDS * gains[this.chosen]
    near = [n for n, gain in gains.items() if gain > least and n != this.chosen]
    return list(dict.fromkeys([*this.alike, *near]))


def _instead(refits: Refits, found: Selection, this: SelectionStep, rival: str) -> Fit | None:
    """The last fit with a rival, which may be in it already, in the place of what a round chose.

    None where another effect has taken the place of the rival's law, or nothing can be simulated.
    """
    assert this.chosen is not None
    others = [n for n in found.effects if n not in (this.chosen, rival)]
    if LIBRARY[rival].replaces_law in {LIBRARY[n].replaces_law for n in others} - {""}:
        return None
    members, final = groups(refits.entries), found.final
    group, place = members[rival], members[this.chosen]
    theta = refits.null(final.theta, place)
    rest = final.free[~np.isin(final.free, place)]
    if rival in found.effects:
        return refits.fit(theta, rest)
    rounds = [this, *found.rounds]
    fits = [t.fit for r in rounds for t in r.tried if t.name == rival]
    start = theta.copy()
    if fits:
        start[group] = fits[0].theta[group]
    else:
        step = next(s.step for r in rounds for s in r.scores if s.name == rival)
        own = np.isin(np.arange(len(theta)), group)
        start = initial_theta(refits.entries, theta, group, np.where(own, step, 0.0))
    return refits.joined(theta, start, np.concatenate([rest, group]))
