"""Computes the verdict on a selection of effects."""

from collections.abc import Sequence

import numpy as np

from calibration.discrepancy.rounds import Selection, scoring_entries
from calibration.inference.goodness import Excess
from calibration.model.extended import Parameter
from slider_jax.effects.library import LIBRARY

NOTHING, IDENTIFIED, CLASS = "nothing_missing", "identified", "class"
UNEXPLAINED, INCONCLUSIVE = "unexplained", "inconclusive"
NAMED = (IDENTIFIED, CLASS)
"""Verdicts after which effects are added to the model."""


def effects_at_bounds(search: Selection, entries: Sequence[Parameter]) -> list[str]:
    """Returns the added effects with a parameter at a bound of its prior range."""
    found, judged = [], scoring_entries(entries)
    for i, p in enumerate(entries):
        if p.effect not in search.effects or i not in judged[p.effect]:
            continue
        x, span = search.final.theta[i], p.prior.high - p.prior.low
        edges = [e for e in (p.prior.low, p.prior.high) if e != p.prior.null]
        if any(abs(x - e) < search.settings.bound_margin * span for e in edges):
            found.append(p.effect)
    return list(dict.fromkeys(found))


def effects_at_same_place(search: Selection) -> list[str]:
    """Returns added effects that act at the same place, without effects that replace a law."""
    kinds = {name: LIBRARY[name] for name in search.effects if not LIBRARY[name].replaces_law}
    places = [kind.place() for kind in kinds.values()]
    return [name for name, kind in kinds.items() if places.count(kind.place()) > 1]


def rms_reduction(before: float, after: float) -> float:
    """Returns the relative reduction of (rms - 1) from the whitened residual's mean squares."""
    start, end = (np.sqrt(max(x, 1.0)) - 1.0 for x in (before, after))
    return float((start - end) / start) if start > 0.0 else 0.0


def reach_verdict(
    search: Selection,
    entries: Sequence[Parameter],
    before: dict[str, Excess],
    after: dict[str, Excess],
) -> str:
    """Returns the verdict; `before` and `after` are the excess of the base fit and final fit.

    If an added effect has a parameter at a bound of its prior range, the verdict is "unexplained".
    If a residual exceeds the noise floor, added effects at one place of the model form a class.
    """
    settings = search.settings
    left = {c: x.all for c, x in after.items() if x.all > settings.noise_floor}
    if not search.final.converged:
        return INCONCLUSIVE
    if not search.effects:
        if left:
            return UNEXPLAINED
        doubtful = [t for r in search.rounds for t in r.refitted if t.worth_naming]
        return INCONCLUSIVE if doubtful else NOTHING
    if effects_at_bounds(search, entries):
        return UNEXPLAINED
    if not all(rms_reduction(before[c].all, after[c].all) >= settings.min_explained for c in left):
        return UNEXPLAINED
    equivalent = any(r.equivalent for r in search.rounds if r.chosen)
    return CLASS if equivalent or (left and effects_at_same_place(search)) else IDENTIFIED
