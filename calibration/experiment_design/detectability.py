"""Computes the detection limits and the equivalence classes of effects in an experiment.

The computation needs no measured data. A is the Fisher information of all trials, F the base
parameters, and e an effect's parameter, at the distance s from its null. Calibration of F absorbs a
part of the effect's gain. The remaining gain is

    gain = s^2 (A_ee - A_eF A_FF^-1 A_Fe)

The loop names the effect if the gain exceeds `required_gain` and a channel changes by more than the
model-discretisation discrepancy. The smallest such s is the decision limit. The detection limit is
larger, so that nine of ten experiments detect the effect despite noise (Currie, L. A. (1968),
Limits for qualitative detection and quantitative determination, Anal. Chem. 40, 586-593).
Two effects form a class if their tangents, without the parts that F absorbs, are parallel.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2

from calibration.discrepancy.rounds import scoring_entries
from calibration.discrepancy.scores import tangent_cosine
from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.experiment_design.information import (
    ChannelInformation,
    TrialInformation,
    channel_shares,
    information,
    predict_information,
)
from calibration.inference.cache import Memo
from calibration.inference.gauss_newton import inverse, marginal_information
from calibration.model.extended import Parameter, candidate_effects
from calibration.model.plan import COARSE, Resolution
from slider_jax.experiment.load import Experiment
from slider_jax.simulation.effect_signature import typical_size

DETECTION_MARGIN = 1.2816
"""Detection limit minus decision limit, in standard errors, for a detection probability of 90 %."""
ABSORBED_SHARE = 1e-9
"""Calibration absorbs an effect if the fit of the base parameters leaves at most this fraction of
the Fisher information about the effect's parameter."""


class DetectionLimit(NamedTuple):
    """Detection limit of one parameter of an effect, as a distance from the parameter's null."""

    parameter: Parameter
    significant: float
    """Smallest distance from the null with a significant gain, in SI units. Infinite if calibration
    absorbs the effect, NaN if the effect cannot be simulated."""
    nameable: float
    """Smallest distance from the null that changes a channel by its discrepancy, in SI units."""
    error: float
    """Standard error of the parameter due to noise, in SI units."""
    finite: bool
    """Whether this limit is computed from a secant instead of the tangent at the null."""

    @property
    def size(self) -> float:
        """Returns the detection limit (SI units). The loop names 9 of 10 effects of this size."""
        return float(np.maximum(self.significant, self.nameable) + DETECTION_MARGIN * self.error)

    @property
    def relative(self) -> float:
        """Returns `size` divided by the distance from the null to the prior range's far end."""
        prior = self.parameter.prior
        return self.size / max(abs(prior.low - prior.null), abs(prior.high - prior.null))

    @property
    def share(self) -> float:
        """Returns the fraction (0 to 1) of the prior range in which the effect is detectable."""
        prior = self.parameter.prior
        beyond = [max(abs(end - prior.null) - self.size, 0.0) for end in (prior.low, prior.high)]
        return sum(beyond) / (prior.high - prior.low) if np.isfinite(self.size) else 0.0


@dataclass(frozen=True)
class DetectabilityMatrix:
    """Detection limits and equivalence classes of the n effects `names` in an experiment."""

    information: TrialInformation
    channels: list[ChannelInformation]
    limits: list[DetectionLimit]
    names: list[str]
    cosines: np.ndarray
    """|cos| between the tangents of two effects, shape (n, n); NaN if an effect is unobservable."""
    opposed: np.ndarray
    """Whether two effects can only change the readings in opposite directions, shape (n, n)."""
    classes: list[list[str]]

    @property
    def limit(self) -> dict[str, list[DetectionLimit]]:
        """Returns the detection limits of each effect, one for each parameter."""
        return {n: [x for x in self.limits if x.parameter.effect == n] for n in self.names}


def required_gain(freedom: int, many: int) -> float:
    """Returns the gain that a candidate with `freedom` parameters needs among `many` candidates."""
    settings = DEFAULT_SETTINGS
    chance = float(chi2.isf(settings.false_alarm_p / many, freedom))
    return max(settings.least_gain(freedom), chance)


def detectability_matrix(
    experiment: Experiment,
    effects: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda text: None,
    coarse: Resolution = COARSE,
    memo: Memo | None = None,
) -> DetectabilityMatrix:
    """Returns the detectability of `effects` in the trials of `experiment`.

    `effects` are names (default: all candidates). The trials need not be measured. Raises
    `InputError` if no noise is declared, and `SolverError` if a trial cannot be simulated.
    """
    names = list(dict.fromkeys(candidate_effects() if effects is None else effects))
    f = predict_information(experiment, names, progress, coarse, memo)
    channels = f.trials(experiment.trials, progress)
    entries, many = f.entries, len(candidate_effects())
    indices, free = scoring_entries(entries), np.flatnonzero([not p.effect for p in entries])
    discrepancies = f.sensing.discrepancies
    limits = [
        DetectionLimit(
            p,
            *_limit(channels, i, free, required_gain(len(indices[p.effect]), many), discrepancies),
            f.chosen[i] in f.secants,
        )
        for i, p in enumerate(entries)
        if p.effect and i in indices[p.effect]
    ]
    A = information(channels)
    cosines, opposed = _pairs(A, names, indices, free, entries)
    found = {x.parameter.effect for x in limits if x.share > 0.0}
    classes = equivalence_classes(names, cosines, opposed, found)
    return DetectabilityMatrix(f, channels, limits, names, cosines, opposed, classes)


def _limit(
    channels: Sequence[ChannelInformation],
    i: int,
    free: np.ndarray,
    gain: float,
    discrepancies: dict[str, float],
) -> tuple[float, float, float]:
    """Returns the fields `significant`, `nameable` and `error` of the limit of parameter `i`."""
    A = information(channels)
    if not np.isfinite(A[i]).all():
        return np.nan, np.nan, np.nan
    rest = float(marginal_information(A, np.array([i]), free)[0, 0])
    if rest <= ABSORBED_SHARE * A[i, i]:
        return np.inf, np.inf, np.inf
    step = np.zeros(len(A))
    step[i], step[free] = 1.0, -inverse(A[np.ix_(free, free)]) @ A[free, i]
    changes = [
        share / max(discrepancies[c], 1e-300) for c, share in channel_shares(channels, step).items()
    ]
    return float(np.sqrt(gain / rest)), 1.0 / max(max(changes), 1e-300), float(1.0 / np.sqrt(rest))


def _pairs(A, names, indices, free, entries) -> tuple[np.ndarray, np.ndarray]:
    """Returns the fields `cosines` and `opposed` of `DetectabilityMatrix`."""
    n = len(names)
    cosines, opposed = np.full((n, n), np.nan), np.zeros((n, n), bool)

    def is_observed(group: np.ndarray) -> bool:
        if not np.isfinite(A[group]).all():
            return False
        remaining = np.diag(marginal_information(A, group, free))
        return bool(np.any(remaining > ABSORBED_SHARE * np.diag(A)[group]))

    observed = [is_observed(indices[name]) for name in names]
    for i in range(n):
        for j in range(i + 1):
            if not (observed[i] and observed[j]):
                continue
            first, second = indices[names[i]], indices[names[j]]
            cos = 1.0 if i == j else tangent_cosine(A, first, second, free)
            cosines[i, j] = cosines[j, i] = min(cos, 1.0)
            opposed[i, j] = opposed[j, i] = i != j and _opposed(A, first, second, free, entries)
    return cosines, opposed


def _opposed(A, first, second, free, entries: Sequence[Parameter]) -> bool:
    """Returns whether two one-sided parameters change the readings in opposite directions."""
    both = np.concatenate([first, second])
    priors = [entries[i].prior for i in both]
    sides = [int(p.low >= p.null) - int(p.high <= p.null) for p in priors]
    if len(both) != 2 or 0 in sides:
        return False
    return bool(sides[0] * sides[1] * marginal_information(A, both, free)[0, 1] < 0.0)


def equivalence_classes(
    names: Sequence[str], cosines: np.ndarray, opposed: np.ndarray, found: set[str]
) -> list[list[str]]:
    """Returns the classes: groups of effects in `found` with |cos| above `parallel_cosine`."""
    linked = (np.nan_to_num(cosines) > DEFAULT_SETTINGS.parallel_cosine) & ~opposed
    there = np.array([name in found for name in names])
    linked &= there[:, None] & there
    count, label = connected_components(coo_array(linked), directed=False)
    every = [[n for n, x in zip(names, label, strict=True) if x == k] for k in range(count)]
    return [sorted(group) for group in every if len(group) > 1]


def effects_at_limits(
    m: DetectabilityMatrix, names: Sequence[str]
) -> tuple[TrialInformation, np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Returns the first four arguments of `separating_trial`, for effects at detection limits.

    If a limit is outside the prior range, the end of the prior range replaces the limit.
    """
    indices, entries = scoring_entries(m.information.entries), m.information.entries
    free = np.flatnonzero([not p.effect for p in entries])
    chosen = np.concatenate([free, *(indices[n] for n in names)])
    f = replace(m.information, chosen=m.information.chosen[chosen])
    before = information(m.channels)[np.ix_(chosen, chosen)]
    sizes = {}
    for name in names:
        ends = [typical_size(x.parameter.prior) - x.parameter.prior.null for x in m.limit[name]]
        sizes[name] = np.sign(ends) * np.minimum(np.abs(ends), [x.size for x in m.limit[name]])
    return f, before, scoring_entries(f.entries), sizes
