"""What a search amounts to, in one of five words, and how far the residual is from its floor."""

from collections.abc import Sequence

import numpy as np

from calibration.discrepancy.rounds import Selection, scored
from calibration.inference.goodness import FLOOR, Excess
from calibration.model.extended import Parameter
from slider_jax.effects.library import LIBRARY

EXPLAINED = 0.9
"""Share of what stood above the floor, in rms, that the effects must remove to be named where they
leave more than the floor."""

EDGE = 0.01
"""Share of the prior range from its end within which a parameter is at the edge."""

NOTHING, IDENTIFIED, CLASS = "nothing_missing", "identified", "class"
UNEXPLAINED, INCONCLUSIVE = "unexplained", "inconclusive"
NAMED = (IDENTIFIED, CLASS)
"""Verdicts after which effects are added to the model."""


def at_bounds(search: Selection, entries: Sequence[Parameter]) -> list[str]:
    """Effects that were added at the edge of what is believed of them."""
    found, judged = [], scored(entries)
    for i, p in enumerate(entries):
        if p.effect not in search.effects or i not in judged[p.effect]:
            continue
        x, span = search.final.theta[i], p.prior.high - p.prior.low
        edges = [e for e in (p.prior.low, p.prior.high) if e != p.prior.null]
        if any(abs(x - e) < EDGE * span for e in edges):
            found.append(p.effect)
    return list(dict.fromkeys(found))


def split(search: Selection) -> list[str]:
    """Effects that enter at one place: one cause may be spread over them.

    One that takes the place of a law is not such a part of a cause.
    """
    kinds = {name: LIBRARY[name] for name in search.effects if not LIBRARY[name].replaces_law}
    places = [kind.place() for kind in kinds.values()]
    return [name for name, kind in kinds.items() if places.count(kind.place()) > 1]


def explained(before: float, after: float) -> float:
    """Share of a channel's rms, less 1 for the floor, that is gone; of mean squares over noise."""
    stood, stands = (np.sqrt(max(x, 1.0)) - 1.0 for x in (before, after))
    return float((stood - stands) / stood) if stood > 0.0 else 0.0


def reach_verdict(
    search: Selection,
    entries: Sequence[Parameter],
    before: dict[str, Excess],
    after: dict[str, Excess],
) -> str:
    """The verdict on a search from the excess of the base model's and of the last fit.

    Effects at the edge of what is believed of them stand in for a cause that is not among the
    candidates. Two of one place that together leave more than noise are a class: of that place.
    """
    left = {c: x.all for c, x in after.items() if x.all > FLOOR}
    if not search.final.converged:
        return INCONCLUSIVE
    if not search.effects:
        if left:
            return UNEXPLAINED
        doubtful = [t for r in search.rounds for t in r.tried if t.worth_naming]
        return INCONCLUSIVE if doubtful else NOTHING
    if at_bounds(search, entries):
        return UNEXPLAINED
    if not all(explained(before[c].all, after[c].all) >= EXPLAINED for c in left):
        return UNEXPLAINED
    alike = any(r.alike for r in search.rounds if r.chosen)
    return CLASS if alike or (left and split(search)) else IDENTIFIED
