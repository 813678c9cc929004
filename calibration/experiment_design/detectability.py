"""What an experiment could detect, and which effects it could not tell apart, before any data.

With A the information of all trials, F the base parameters and e one parameter of an effect, what
calibration cannot absorb of a size s is

    gain = s^2 A'_ee,    A' = A_ee - A_eF A_FF^-1 A_Fe

It is found where the gain is what the search asks for, and named where it changes some channel by
more than two correct programs differ by. The detection limit lies beyond both by so much that noise
lets nine of ten such effects pass (Currie, L. A. (1968), Limits for qualitative detection and
quantitative determination, Anal. Chem. 40, 586-593). Two effects whose A' are parallel are one
class.
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
    as_block,
    channel_shares,
    information,
    predict_information,
)
from calibration.inference.cache import Memo
from calibration.inference.gauss_newton import inverse, marginal_information
from calibration.model.extended import Parameter, candidates
from calibration.model.predict import COARSE, Resolution
from slider_jax.channels import CHANNELS
from slider_jax.effects import Prior
from slider_jax.experiment.load import Experiment
from slider_jax.simulation.effect_signature import typical

POWER = 1.2816
"""Standard errors beyond the decision limit at which nine of ten are detected."""
ABSORBED = 1e-9
"""Share of a parameter's information below which calibration absorbs all of it."""


class Limit(NamedTuple):
    """The size from which on an effect's parameter would be found and named."""

    parameter: Parameter
    significant: float
    """Distance from the null, SI, at which it is beyond chance; infinite where calibration absorbs
    it, NaN where it cannot be simulated."""
    nameable: float
    """Distance at which it changes a channel by more than correct programs differ by."""
    error: float
    """Standard error that the noise would leave of it."""
    finite: bool
    """Whether a finite start took the place of a tangent that tells too little."""

    @property
    def size(self) -> float:
        """The detection limit: beyond both by what noise may take away, in nine cases of ten."""
        return float(np.maximum(self.significant, self.nameable) + POWER * self.error)

    @property
    def relative(self) -> float:
        """The limit as a share of the distance from the null to the far end of the prior range."""
        prior = self.parameter.prior
        return self.size / max(abs(prior.low - prior.null), abs(prior.high - prior.null))

    @property
    def share(self) -> float:
        """Share of the prior range that lies beyond the limit, 0 to 1."""
        prior = self.parameter.prior
        beyond = [max(abs(end - prior.null) - self.size, 0.0) for end in (prior.low, prior.high)]
        return sum(beyond) / (prior.high - prior.low) if np.isfinite(self.size) else 0.0


@dataclass(frozen=True)
class Matrix:
    """What an experiment could say of effects."""

    information: TrialInformation
    channels: list[ChannelInformation]
    limits: list[Limit]
    names: list[str]
    alike: np.ndarray
    """(n, n) |cos| of two effects; NaN where an effect is not seen at all."""
    opposed: np.ndarray
    """(n, n) whether the signs of the parameters tell two effects apart."""
    classes: list[list[str]]

    @property
    def limit(self) -> dict[str, list[Limit]]:
        """By effect."""
        return {n: [x for x in self.limits if x.parameter.effect == n] for n in self.names}


def required_gain(freedom: int, many: int) -> float:
    """The gain from which on the search finds one of `many` candidates."""
    return max(
        DEFAULT_SETTINGS.min_gain,
        float(chi2.isf(DEFAULT_SETTINGS.false_alarm_p / many, freedom)),
    )


def detectability_matrix(
    experiment: Experiment,
    effects: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda text: None,
    coarse: Resolution = COARSE,
    memo: Memo | None = None,
) -> Matrix:
    """What the trials of `experiment` could detect of `effects`, by default of all candidates.

    Nothing needs to be measured. Raises `InputError` where no noise is declared, `SolverError`
    where a trial cannot be simulated.
    """
    names = list(dict.fromkeys(candidates() if effects is None else effects))
    f = predict_information(experiment, names, progress, coarse, memo)
    channels = f.trials(experiment.trials, progress)
    entries, many = f.entries, len(candidates())
    members, free = scoring_entries(entries), np.flatnonzero([not p.effect for p in entries])
    limits = [
        Limit(
            p,
            *_limit(channels, i, free, required_gain(len(members[p.effect]), many)),
            i in f.secants,
        )
        for i, p in enumerate(entries)
        if p.effect and i in members[p.effect]
    ]
    A = information(channels)
    alike, opposed = _pairs(A, names, members, free, entries)
    found = {x.parameter.effect for x in limits if x.share > 0.0}
    return Matrix(f, channels, limits, names, alike, opposed, classes(names, alike, opposed, found))


def _limit(
    channels: Sequence[ChannelInformation], i: int, free: np.ndarray, gain: float
) -> tuple[float, float, float]:
    """Sizes at which the entry `i` is beyond chance, and worth naming, and its standard error."""
    A = information(channels)
    if not np.isfinite(A[i]).all():
        return np.nan, np.nan, np.nan
    kept = float(marginal_information(A, np.array([i]), free)[0, 0])
    if kept <= ABSORBED * A[i, i]:
        return np.inf, np.inf, np.inf
    step = np.zeros(len(A))
    step[i], step[free] = 1.0, -inverse(A[np.ix_(free, free)]) @ A[free, i]
    changes = [
        share / CHANNELS[c].discrepancy for c, share in channel_shares(channels, step).items()
    ]
    return float(np.sqrt(gain / kept)), 1.0 / max(max(changes), 1e-300), float(1.0 / np.sqrt(kept))


def _pairs(A, names, members, free, entries) -> tuple[np.ndarray, np.ndarray]:
    """|cos| of all pairs, and which pairs are told apart by sign."""
    n = len(names)
    alike, opposed = np.full((n, n), np.nan), np.zeros((n, n), bool)
    lost = [not _is_seen(A, members[name], free) for name in names]
    for i in range(n):
        for j in range(i + 1):
            if lost[i] or lost[j]:
                continue
            first, second = members[names[i]], members[names[j]]
            cos = 1.0 if i == j else tangent_cosine(first, second, free, as_block(A))
            alike[i, j] = alike[j, i] = min(cos, 1.0)
            opposed[i, j] = opposed[j, i] = i != j and _opposed(A, first, second, free, entries)
    return alike, opposed


def _is_seen(A: np.ndarray, group: np.ndarray, free: np.ndarray) -> bool:
    if not np.isfinite(A[group]).all():
        return False
    return bool(
        np.any(np.diag(marginal_information(A, group, free)) > ABSORBED * np.diag(A)[group])
    )


def _opposed(A, first, second, free, entries: Sequence[Parameter]) -> bool:
    """Whether two one-sided parameters change the readings in opposite directions."""
    both = np.concatenate([first, second])
    sides = [_side(entries[i].prior) for i in both]
    if len(both) != 2 or 0 in sides:
        return False
    return bool(sides[0] * sides[1] * marginal_information(A, both, free)[0, 1] < 0.0)


def _side(prior: Prior) -> int:
    """1 or -1 where a parameter may lie on that side of its null alone, else 0."""
    return int(prior.low >= prior.null) - int(prior.high <= prior.null)


def classes(
    names: Sequence[str], alike: np.ndarray, opposed: np.ndarray, found: set[str]
) -> list[list[str]]:
    """Groups of the effects `found` that cannot be told apart: |cos| above `parallel_cosine`."""
    linked = (np.nan_to_num(alike) > DEFAULT_SETTINGS.parallel_cosine) & ~opposed
    there = np.array([name in found for name in names])
    linked &= there[:, None] & there
    count, label = connected_components(coo_array(linked), directed=False)
    every = [[n for n, x in zip(names, label, strict=True) if x == k] for k in range(count)]
    return [sorted(group) for group in every if len(group) > 1]


class AtLimits(NamedTuple):
    """What `separation.separate` needs of some effects, each as large as its detection limit."""

    information: TrialInformation
    before: np.ndarray
    members: dict[str, np.ndarray]
    sizes: dict[str, np.ndarray]


def at_limits(m: Matrix, names: Sequence[str]) -> AtLimits:
    """The base model and the effects `names` alone.

    A parameter that the experiment could not find is taken at the end of its prior range.
    """
    members, entries = scoring_entries(m.information.entries), m.information.entries
    free = np.flatnonzero([not p.effect for p in entries])
    chosen = np.concatenate([free, *(members[n] for n in names)])
    f = replace(m.information, chosen=m.information.chosen[chosen])
    before = information(m.channels)[np.ix_(chosen, chosen)]
    sizes = {}
    for name in names:
        ends = [typical(x.parameter.prior) - x.parameter.prior.null for x in m.limit[name]]
        found = [x.size for x in m.limit[name]]
        sizes[name] = np.sign(ends) * np.minimum(np.abs(ends), found)
    return AtLimits(f, before, scoring_entries(f.entries), sizes)
