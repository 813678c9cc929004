"""Selects groups of dictionary terms by group matching pursuit on normal equations.

A group contains the parameters of one term. The base parameters and the effects found before are
projected out of every score. At each place, the pursuit adds the group with the largest surplus:
its gain minus the gain that chance allows, corrected for all groups of all places. The place with
the largest surplus is the place of the learned function. Source: Tropp, J. A. and Gilbert, A. C.
(2007), Signal recovery from random measurements via orthogonal matching pursuit, IEEE Trans. Inf.
Theory 53, 4655-4666.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from calibration.discrepancy.rounds import agreement
from calibration.discrepancy.scores import (
    Score,
    least_squares_step,
    score,
    square_after,
    square_reduction,
)
from calibration.discrepancy.settings import DEFAULT_SETTINGS, SelectionSettings
from calibration.inference.gauss_newton import inverse, marginal_information
from calibration.inference.problem import ChannelBlock, summed

MAX_GROUPS = 3
"""Largest number of groups of a learned function."""
MIN_HALF = 3
"""Smallest number of trials in each half, because cross-validation needs three trials."""
CONFIRMATION_P = 0.01
"""The estimation half confirms a group if the p-value of its gain, corrected for the number of
selected groups, is below this value."""
UNSTABLE_CHANGE = 0.5
"""A group is unstable if the function of the group changes by more than this fraction when one
trial is left out. A parameter with the other sign changes by more than 1."""

Groups = Mapping[str, np.ndarray]
"""Indices of the parameters of each term."""


class PlaceGain(NamedTuple):
    """Result of the pursuit at one place."""

    place: str
    groups: list[str]
    """Selected terms, in the order of the selection."""
    gain: float
    """Reduction of the sum of squares, divided by the mean square of the residual afterwards."""
    surplus: float
    """Sum of the groups' gains beyond the gains that chance allows."""


class Stability(NamedTuple):
    """Whether the trials that did not select a group confirm it."""

    p: float
    """p-value of the group's gain, corrected for the number of selected groups."""
    change: float
    """Largest relative change of the group's function when one trial is left out."""

    @property
    def confirmed(self) -> bool:
        """Returns whether the group is significant and stable."""
        return self.p < CONFIRMATION_P and self.change < UNSTABLE_CHANGE


def halves(frequencies: Sequence[float | None]) -> tuple[list[int], list[int]]:
    """Returns the indices of every second trial, sorted by frequency, and of the other trials."""
    order = sorted(range(len(frequencies)), key=lambda i: (frequencies[i] or 0.0, i))
    return sorted(order[::2]), sorted(order[1::2])


def mean_square(blocks: Sequence[ChannelBlock], free: np.ndarray) -> float:
    """Returns the mean square of the residual after a fit of the entries `free`, at least 1."""
    after = square_after(blocks, least_squares_step(*summed(blocks), free))
    return max(1.0, after / max(sum(x.n for x in blocks) - len(free), 1))


def _surplus(found: Score, group: np.ndarray, many: int, settings: SelectionSettings) -> float:
    """Returns the gain minus the larger of the naming threshold and the gain that chance allows."""
    chance = float(chi2.isf(settings.false_alarm_p / many, len(group)))
    return found.gain - max(chance, settings.least_gain(len(group)))


def pursue(
    blocks: Sequence[ChannelBlock],
    free: np.ndarray,
    groups: Groups,
    many: int,
    settings: SelectionSettings = DEFAULT_SETTINGS,
) -> tuple[list[str], float]:
    """Returns the selected groups, best first, and the sum of their surpluses.

    `free` are the indices of the parameters to project out, and `many` the number of groups for
    which the chance level is corrected.
    """
    chosen: list[str] = []
    total, known = 0.0, free
    while len(chosen) < MAX_GROUPS:
        unit, found = mean_square(blocks, known), {}
        for name in groups.keys() - set(chosen):
            x = score(name, groups[name], known, blocks, unit, many, settings)
            surplus = _surplus(x, groups[name], many, settings)
            if surplus > 0.0 and agreement(x.left_out).agreed(settings):
                found[name] = surplus
        if not found:
            break
        best = max(sorted(found), key=lambda name: found[name])
        chosen.append(best)
        total, known = total + found[best], np.concatenate([known, groups[best]])
    return chosen, total


def place_gains(
    blocks: Sequence[ChannelBlock],
    free: np.ndarray,
    places: Mapping[str, Groups],
    settings: SelectionSettings = DEFAULT_SETTINGS,
) -> list[PlaceGain]:
    """Returns the result of the pursuit at each of the `places`, largest surplus first."""
    many, found = sum(len(groups) for groups in places.values()), []
    for place, groups in places.items():
        chosen, surplus = pursue(blocks, free, groups, many, settings)
        both = np.concatenate([free, *(groups[name] for name in chosen)])
        gain = _reduction(blocks, both) - _reduction(blocks, free)
        found.append(PlaceGain(place, chosen, gain / mean_square(blocks, both), surplus))
    return sorted(found, key=lambda x: -x.surplus)


def _reduction(blocks: Sequence[ChannelBlock], free: np.ndarray) -> float:
    return square_reduction(blocks, least_squares_step(*summed(blocks), free))


def stability(
    blocks: Sequence[ChannelBlock], values: np.ndarray, group: np.ndarray, many: int, unit: float
) -> Stability:
    """Returns the stability of the fitted `group` in the trials of the estimation.

    `blocks` are the normal equations of the fitted parameters at the optimum, `values` the fitted
    values minus the nulls, and `group` the places of the group in them. `unit` is the residual's
    mean square. The group's function is measured by the change of the readings that the other
    parameters cannot absorb.
    """
    A, _ = summed(blocks)
    rest = np.setdiff1d(np.arange(len(A)), group)
    metric, a = marginal_information(A, group, rest), values[group]
    size = float(a @ metric @ a)
    p = min(1.0, many * float(chi2.sf(max(size, 0.0) / unit, len(group))))
    changes = []
    for trial in {x.trial for x in blocks}:
        own_A, own_b = summed([x for x in blocks if x.trial != trial])
        step = (inverse(own_A) @ own_b)[group]
        changes.append(float(step @ metric @ step))
    return Stability(p, float(np.sqrt(max(changes) / max(size, 1e-300))))
