"""Selects groups of dictionary terms by group matching pursuit on normal equations.

A group contains the parameters of one term. In every score, the base parameters and the effects
found before are projected out. The surplus of a group is its gain minus the gain that chance
allows, corrected for all groups of all places. At each place, the pursuit adds the group with the
largest surplus, one group after another. The learned function is at the place with the largest
total surplus. Source: Tropp, J. A. and Gilbert, A. C. (2007), Signal recovery from random
measurements via orthogonal matching pursuit, IEEE Trans. Inf. Theory 53, 4655-4666.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from calibration.discrepancy.refits import FitStart, Refits, Tangents, initial_theta
from calibration.discrepancy.rounds import agreement
from calibration.discrepancy.scores import Score, score
from calibration.discrepancy.settings import SelectionSettings
from calibration.inference.gauss_newton import Fit, inverse, marginal_information
from calibration.inference.problem import ChannelBlock, summed, trial_equations
from calibration.measurements.records import Record

MAX_GROUPS = 3
"""Largest number of groups of a learned function."""
PARTS = 4
"""Number of parts of a trial, which alternately select and estimate groups."""
MIN_TRIALS = 6
"""Smallest number of trials. With fewer trials, cross-validation hardly tests whether a function is
also valid under other conditions."""
CONFIRMATION_P = 0.01
"""The estimation half confirms a group if the p-value of its gain, corrected for the selected
groups of all places, is below this value."""
SHORT_LIST = 4
"""Largest number of groups that a step of the pursuit refits."""
START_SHARES = (1.0, 0.3)
"""A refit starts at these fractions of the linear step, because the whole step can be too long."""
MAX_PLACES = 3
"""Largest number of places at which the pursuit refits groups."""
RIDGE = 0.01
"""Ridge of the scores. Without a ridge, functions that resemble each other in short trials can have
large, opposite factors, and fail in a longer trial."""
UNSTABLE_CHANGE = 0.5
"""A group is unstable if the function of the group changes by more than this fraction when one
trial is left out. If a parameter changes its sign, its relative change exceeds 1."""

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
    """Sum of the surpluses of the selected groups."""
    fit: Fit
    """The fit with the selected terms."""


class Stability(NamedTuple):
    """Significance and stability of a group."""

    p: float
    """p-value of the group's gain, corrected for the selected groups of all places."""
    change: float
    """Largest relative change of the group's function when one trial is left out."""

    @property
    def significant(self) -> bool:
        """Returns whether the group is significant."""
        return self.p < CONFIRMATION_P

    @property
    def confirmed(self) -> bool:
        """Returns whether the group is significant and stable."""
        return self.significant and self.change < UNSTABLE_CHANGE


def in_selection(record: Record) -> np.ndarray:
    """Returns the mask (n,) of the samples that select groups: two of four parts of the trial.

    The other samples estimate the groups. All conditions therefore occur in both halves.
    """
    return np.floor(PARTS * record.t / record.trial.duration) % 2 == 0


def _required_gain(count: int, many: int, settings: SelectionSettings) -> float:
    """Returns the gain that a group with `count` parameters must exceed, for `many` groups."""
    chance = float(chi2.isf(settings.false_alarm_p / many, count))
    return max(chance, settings.least_gain(count))


def _surplus(refits: Refits, current: Fit, fit: Fit, many: int) -> float:
    gain = (current.square - fit.square) / fit.inflation
    return gain - _required_gain(len(fit.free) - len(current.free), many, refits.settings)


def _predicts(x: Score, settings: SelectionSettings) -> bool:
    """Returns whether cross-validation confirms a group.

    A group only approximates the missing law, so it may increase the error of some trials. As in
    the selection of effects, the gain without the best trial must be large. A loss is compared with
    the sum of all gains.
    """
    found = agreement(x.left_out, x.held_gains)
    gains = float(np.sum(np.maximum(x.held_gains, 0.0)))
    small = -found.least_gain <= settings.most_loss_share * gains
    return found.agreed(settings) or (found.rest_gain > settings.least_rest_gain and small)


def _short_list(
    refits: Refits,
    current: Fit,
    groups: Groups,
    blocks: Sequence[ChannelBlock],
    many: int,
    earlier: Sequence[int] = (),
) -> list[tuple[float, Score]]:
    """Returns significant groups that cross-validation confirms: (surplus, score), best first.

    `earlier` are the parameters of the groups that were chosen before.
    """
    found, settings, unit = [], refits.settings, current.inflation
    for name, group in groups.items():
        x = score(name, group, current.free, blocks, unit, many, settings, RIDGE, earlier)
        surplus = x.gain - _required_gain(len(group), many, settings)
        if surplus > 0.0 and _predicts(x, settings):
            found.append((surplus, x))
    return sorted(found, key=lambda pair: -pair[0])


def pursue(
    refits: Refits, start: Fit, place: str, groups: Groups, J: Tangents, many: int
) -> PlaceGain:
    """Returns the result of the pursuit at one place.

    `start` is the fit without the `groups`, `J` are its whitened tangents, and `many` is the number
    of groups that chance allows for.
    """
    current, chosen, total = start, list[str](), 0.0
    while len(chosen) < MAX_GROUPS:
        residuals = refits.problem.residuals(current.predicted, refits.white)
        rest = {name: x for name, x in groups.items() if name not in chosen}
        blocks = trial_equations(residuals, J)
        earlier = [i for name in chosen for i in groups[name]]
        scores = _short_list(refits, current, rest, blocks, many, earlier)
        lanes = [(x, share) for _, x in scores[:SHORT_LIST] for share in START_SHARES]
        starts = [
            FitStart(
                initial_theta(refits, current.theta, groups[x.name], share * x.step),
                np.concatenate([current.free, groups[x.name]]),
                current.theta,
            )
            for x, share in lanes
        ]
        fits = refits.estimated(current, starts, J, judge=True)
        named = zip(fits, (x.name for x, _ in lanes), strict=True)
        gains = [(_surplus(refits, current, fit, many), name, fit) for fit, name in named]
        surplus, name, fit = max(gains, key=lambda x: x[0], default=(0.0, "", current))
        if surplus <= 0.0:
            break
        refits.progress(f"{place}: adding {name}")
        chosen.append(name)
        total, current = total + surplus, fit
    gain = (start.square - current.square) / current.inflation
    return PlaceGain(place, chosen, gain, total, current)


def place_gains(
    refits: Refits, start: Fit, places: Mapping[str, Groups], J: Tangents
) -> list[PlaceGain]:
    """Returns the result of the pursuit at each of the `places`, largest surplus first.

    `start` is the fit without terms, and `J` are its whitened tangents. The pursuit runs only at
    the `MAX_PLACES` places with the best scores, and refits only the groups with the best scores.
    """
    many = sum(len(groups) for groups in places.values())
    residuals = refits.problem.residuals(start.predicted, refits.white)
    blocks = trial_equations(residuals, J)
    first = {
        place: max((x for x, _ in _short_list(refits, start, groups, blocks, many)), default=0.0)
        for place, groups in places.items()
    }
    best = sorted(first, key=lambda place: -first[place])
    tried = [place for place in best[:MAX_PLACES] if first[place] > 0.0]
    found = [pursue(refits, start, place, places[place], J, many) for place in tried]
    found += [PlaceGain(place, [], 0.0, 0.0, start) for place in best if place not in tried]
    return sorted(found, key=lambda x: -x.surplus)


def stability(fit: Fit, group: np.ndarray, many: int) -> Stability:
    """Returns the stability of the `group` in the trials of a fit.

    `group` are indices of the fitted parameters `fit.free`; the nulls of the group are zero. `many`
    is the number of selected groups of all places. The change of the group's function is measured
    in the readings of the remaining trials. Only the part of the change that the other parameters
    cannot absorb counts.
    """
    blocks = fit.blocks
    A, b = summed(blocks)
    remaining = inverse(A) @ b
    rest = np.setdiff1d(np.arange(len(A)), group)
    metric, a = marginal_information(A, group, rest), fit.theta[fit.free][group]
    size = float(a @ metric @ a)
    p = min(1.0, many * float(chi2.sf(max(size, 0.0) / fit.inflation, len(group))))
    changes = []
    for trial in {x.trial for x in blocks}:
        own_A, own_b = summed([x for x in blocks if x.trial != trial])
        own = marginal_information(own_A, group, rest)
        step = (inverse(own_A) @ own_b - remaining)[group]
        changes.append(float(step @ own @ step) / max(float(a @ own @ a), 1e-300))
    return Stability(p, float(np.sqrt(max(changes))))
