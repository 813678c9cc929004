"""How far apart the readings put two effects, and the trial that puts them furthest apart.

Between two effects a and b it is what b and the base parameters F leave of a at its size s:

    lambda = s^2 (A_aa - A_aR A_RR^-1 A_Ra),    R = F and b

the noncentral chi-square of taking b for a; its root is the distance in standard deviations. Of a
pair the smaller of both ways counts, of several pairs the smallest.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from calibration.discrepancy.scores import tangent_cosine
from calibration.experiment_design.information import (
    ChannelInformation,
    TrialInformation,
    as_block,
    information,
)
from calibration.experiment_design.trial_search import (
    SearchEffort,
    TrialLimits,
    TrialSearch,
    as_table,
    trial_text,
    trial_toml,
)
from calibration.inference.gauss_newton import marginal_information

APART = 3.0
"""Standard deviations from which on two effects count as told apart."""


class Pair(NamedTuple):
    """Two effects, and how far apart the readings put them."""

    first: str
    second: str
    cos: float
    sigmas: float


def pairs_of(
    A: np.ndarray,
    members: Mapping[str, np.ndarray],
    sizes: Mapping[str, np.ndarray],
    free: np.ndarray,
) -> list[Pair]:
    """All pairs of `members` (indices by name) at their `sizes`, with the information A."""
    found = []
    for first, second in combinations(members, 2):
        one, other = members[first], members[second]
        ways = (
            _distance(A, one, np.concatenate([free, other]), sizes[first]),
            _distance(A, other, np.concatenate([free, one]), sizes[second]),
        )
        cos = min(tangent_cosine(one, other, free, as_block(A)), 1.0)
        found.append(Pair(first, second, cos, float(np.sqrt(min(ways)))))
    return found


def _distance(A: np.ndarray, group: np.ndarray, rest: np.ndarray, size: np.ndarray) -> float:
    return max(float(size @ marginal_information(A, group, rest) @ size), 0.0)


def separation_score(pairs: Sequence[Pair]) -> float:
    """What separating maximises: the smallest distance, and a little of the mean one."""
    squares = [pair.sigmas**2 for pair in pairs]
    return min(squares) + 1e-3 * float(np.mean(squares))


def separate(
    f: TrialInformation,
    before: np.ndarray,
    members: Mapping[str, np.ndarray],
    sizes: Mapping[str, np.ndarray],
    limits: TrialLimits,
    effort: SearchEffort = SearchEffort(),
    progress: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """The trial that tells the effects `members` apart best, as reports write it.

    `members` are their places in `f.chosen`, `sizes` how large they are believed to be; what is
    neither of them is free to move. `before` (k, k) is the information of the trials there are.
    """
    taken = np.concatenate(list(members.values()))
    free = np.setdiff1d(np.arange(len(f.chosen)), taken)

    def goal(channels: list[list[ChannelInformation]]) -> float:
        return separation_score(pairs_of(before + information(channels[0]), members, sizes, free))

    best = TrialSearch([f], goal, limits).run(effort, progress)
    after = before + information(best.channels[0])
    now, then = (pairs_of(A, members, sizes, free) for A in (before, after))
    rows = [
        {
            "first": a.first,
            "second": a.second,
            "cos_before": a.cos,
            "cos_after": b.cos,
            "sigmas_before": a.sigmas,
            "sigmas_after": b.sigmas,
        }
        for a, b in zip(now, then, strict=True)
    ]
    worst = min(then, key=lambda pair: pair.sigmas)
    was = next(p.sigmas for p in now if (p.first, p.second) == (worst.first, worst.second))
    found = f"{trial_text(best.trial)} tells {_listed(list(members))} apart best: "
    said = (
        f"{worst.first} from {worst.second} by {worst.sigmas:.1f} standard deviations "
        f"({was:.1f} without it)."
    )
    if worst.sigmas < APART:
        said += " That is too little to tell them apart: no trial within the limits does."
    return {
        "purpose": "separate",
        "said": found[0].upper() + found[1:] + said,
        "trial": as_table(best.trial),
        "toml": trial_toml(best.trial),
        "pairs": rows,
        "sizes": {name: sizes[name] for name in members},
        "limits": limits._asdict(),
    }


def _listed(names: list[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"
