"""Computes the verdict: a status for each added effect, and whether the residual is noise."""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np

from calibration.discrepancy.ranges import at_edge
from calibration.discrepancy.rounds import Selection, effect_entries, scoring_entries
from calibration.discrepancy.settings import SelectionSettings
from calibration.inference.gauss_newton import Fit
from calibration.inference.goodness import Excess
from calibration.inference.uncertainty import includes_null
from slider_jax.channels import ChannelSet

NOTHING, IDENTIFIED, CLASS = "nothing_missing", "identified", "class"
PARTLY, UNEXPLAINED, INCONCLUSIVE = "partly_explained", "unexplained", "inconclusive"
BEYOND_PRIOR, PROVISIONAL = "beyond_prior", "provisional"
"""Further statuses of an added effect, in addition to `IDENTIFIED` and `CLASS`."""
LEARNED = "learned"
"""Status of a learned function, and the verdict if the residual with this function is noise."""


class EffectStatus(NamedTuple):
    """The first part of the verdict, for one added effect."""

    name: str
    status: str
    equivalent: list[str]
    """Effects that these data cannot discriminate from the effect."""
    above_floor: list[str]
    """Channels above the noise floor that the effect changes or that its own channels depend on."""
    beyond: list[int]
    """Parameters (indices of the entries) with a value outside the declared prior range."""
    is_correction: bool
    """Whether the effect may be absent or only resemble the cause."""
    includes_null: bool
    """Whether the 95 % interval of the effect's size includes the null, with the other effects in
    the model. The effect may then be absent."""


def channels_above_floor(after: Mapping[str, Excess], settings: SelectionSettings) -> list[str]:
    """Returns the channels whose residual is above the noise floor, or is not white."""
    return [c for c, x in after.items() if x.above(settings.noise_floor)]


def parameters_beyond_prior(search: Selection, theta: np.ndarray, name: str) -> list[int]:
    """Returns the parameters of an effect that are outside their declared prior range."""
    found = []
    for i, declared in search.declared.items():
        p, x = search.entries[i], theta[i]
        outside = at_edge(x, declared, 0.0)
        if p.effect == name and (outside or at_edge(x, p.prior, search.settings.bound_margin)):
            found.append(i)
    return sorted(found)


def judge_effects(
    search: Selection,
    final: Fit,
    after: Mapping[str, Excess],
    channels: ChannelSet,
    replaceable: bool = False,
) -> list[EffectStatus]:
    """Returns the status of each added effect.

    `final` is the final model, fitted to all trials, and `after` are the residual mean squares of
    the trials that were not held out. An effect is provisional if one of these conditions is true:

    - the residual of a channel that it changes is above the noise floor,
    - it changes only forces and motion, and a pressure is above the noise floor, so that it may
      correct what the wrong pressure causes,
    - the 95 % interval of its size includes the null,
    - the final fit did not converge,
    - the effects are `replaceable` by a learned function.

    The size consists of the entries of `scoring_entries`. The other parameters of the effect are
    fixed at their fitted values for this interval, because an uncertain shape does not make an
    effect absent. An effect outside its prior range is beyond_prior instead of provisional.
    """
    left, found = channels_above_floor(after, search.settings), []
    pressures, groups = channels.pressures, effect_entries(search.entries)
    scored = scoring_entries(search.entries)
    for round_ in search.rounds:
        name = round_.chosen
        if name is None or name not in search.effects:
            continue
        sizes = next(t.sizes for t in round_.refitted if t.name == name)
        changed = [c for c, x in sizes.items() if x > search.discrepancies[c]]
        driven = bool(changed) and not any(c in pressures for c in changed)
        above = [c for c in left if c in changed or (c in pressures and driven)]
        beyond = parameters_beyond_prior(search, final.theta, name)
        rest = [i for i in groups[name] if i not in scored[name]]
        absent = includes_null(final.with_fixed(rest), search.entries, scored[name])
        doubtful = bool(above) or absent or replaceable or not search.final.converged
        status = _status(round_.equivalent, beyond, doubtful)
        found.append(EffectStatus(name, status, round_.equivalent, above, beyond, doubtful, absent))
    return found


def _status(equivalent: list[str], beyond: list[int], doubtful: bool) -> str:
    if equivalent and not doubtful:
        return CLASS
    if beyond:
        return BEYOND_PRIOR
    return PROVISIONAL if doubtful else IDENTIFIED


def reach_verdict(
    search: Selection, statuses: Collection[EffectStatus], after: Mapping[str, Excess]
) -> str:
    """Returns the overall verdict from the statuses of the effects and the final residual.

    If the final fit did not converge, the verdict is partly_explained if the model has added
    effects and a residual above the noise floor, and otherwise inconclusive. If the residual is at
    the noise floor, but each added effect may be absent, the verdict is also inconclusive.
    """
    left = channels_above_floor(after, search.settings)
    if not search.final.converged:
        return PARTLY if statuses and left else INCONCLUSIVE
    if not statuses:
        if left:
            return UNEXPLAINED
        doubtful = [t for r in search.rounds for t in r.refitted if t.worth_naming]
        return INCONCLUSIVE if doubtful else NOTHING
    if left:
        return PARTLY
    if all(x.includes_null for x in statuses):
        return INCONCLUSIVE
    return CLASS if any(x.status == CLASS for x in statuses) else IDENTIFIED
