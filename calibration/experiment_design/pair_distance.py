"""Computes the distance between the readings of two effects, and the trial that maximises it.

Let a be an effect of size s, A the Fisher information, and R the base parameters together with a
second effect b. After a fit of R to the readings of a, the residual's sum of squares is

    lambda = s^2 (A_aa - A_aR A_RR^-1 A_Ra)

Lambda is the noncentrality of the chi-square test that rejects b if a is true. The square root of
lambda is a distance in standard deviations. The distance of a pair is the smaller of two values:
with b fitted to a, and with a fitted to b.
"""

from collections.abc import Callable, Mapping
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from calibration.discrepancy.scores import tangent_cosine
from calibration.experiment_design.information import (
    ChannelInformation,
    TrialInformation,
    information,
)
from calibration.experiment_design.trial_search import (
    SearchEffort,
    TrialLimits,
    TrialSearch,
    next_trial_record,
    trial_text,
)
from calibration.inference.gauss_newton import marginal_information

DISCRIMINATED_SIGMAS = 3.0
"""Distance in standard deviations above which the data discriminate between two effects."""


class EffectPair(NamedTuple):
    """Two effects, |cos| between their tangents, and their distance in standard deviations."""

    first: str
    second: str
    cos: float
    sigmas: float


def effect_pairs(
    A: np.ndarray,
    indices: Mapping[str, np.ndarray],
    sizes: Mapping[str, np.ndarray],
    free: np.ndarray,
) -> list[EffectPair]:
    """Returns all pairs of effects.

    `indices` are the row numbers in A of each effect's parameters. `free` are the row numbers of
    the parameters that every fit adjusts.
    """
    found = []
    for first, second in combinations(indices, 2):
        one, other = indices[first], indices[second]
        squares = (
            _distance(A, one, np.concatenate([free, other]), sizes[first]),
            _distance(A, other, np.concatenate([free, one]), sizes[second]),
        )
        cos = min(tangent_cosine(A, one, other, free), 1.0)
        found.append(EffectPair(first, second, cos, float(np.sqrt(min(squares)))))
    return found


def _distance(A: np.ndarray, group: np.ndarray, rest: np.ndarray, size: np.ndarray) -> float:
    return max(float(size @ marginal_information(A, group, rest) @ size), 0.0)


def separating_trial(
    f: TrialInformation,
    before: np.ndarray,
    indices: Mapping[str, np.ndarray],
    sizes: Mapping[str, np.ndarray],
    limits: TrialLimits,
    effort: SearchEffort = SearchEffort(),
    progress: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Returns the record of the trial that discriminates best between effects.

    `indices` are the positions of each effect's parameters in `f.chosen`, and `sizes` their assumed
    values. All other parameters are refitted. `before` (k, k): information of existing trials.
    """
    effects = np.concatenate(list(indices.values()))
    free = np.setdiff1d(np.arange(len(f.chosen)), effects)

    def goal(channels: list[list[ChannelInformation]]) -> float:
        """Returns the smallest squared distance plus 0.1 % of the mean squared distance."""
        A = before + information(channels[0])
        squares = [pair.sigmas**2 for pair in effect_pairs(A, indices, sizes, free)]
        return min(squares) + 1e-3 * float(np.mean(squares))

    best = TrialSearch([f], goal, limits).run(effort, progress)
    after = before + information(best.channels[0])
    now, then = (effect_pairs(A, indices, sizes, free) for A in (before, after))
    rows = [
        {"first": a.first, "second": a.second}
        | {"cos_before": a.cos, "cos_after": b.cos}
        | {"sigmas_before": a.sigmas, "sigmas_after": b.sigmas}
        for a, b in zip(now, then, strict=True)
    ]
    was, worst = min(zip(now, then, strict=True), key=lambda pair: pair[1].sigmas)
    *names, last = indices
    text = (
        f"{trial_text(best.trial)} discriminates best between {', '.join(names)} and {last}: the "
        f"distance between {worst.first} and {worst.second} grows from {was.sigmas:.1f} to "
        f"{worst.sigmas:.1f} standard deviations."
    )
    if worst.sigmas < DISCRIMINATED_SIGMAS:
        text += (
            f" No trial within the limits reaches the required {DISCRIMINATED_SIGMAS:g} standard "
            "deviations."
        )
    return next_trial_record("separate", text, best.trial, limits) | {
        "pairs": rows,
        "sizes": {name: sizes[name] for name in indices},
    }
