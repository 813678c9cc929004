"""Widens the prior range of a selected effect if the fit ends at an edge of this range."""

from collections.abc import Callable, Sequence

import numpy as np

from calibration.discrepancy.rounds import Selection, scoring_entries
from calibration.discrepancy.settings import SelectionSettings
from calibration.inference.gauss_newton import Fit
from calibration.inference.uncertainty import confidence_interval, determined
from calibration.model.extended import Parameter
from slider_jax.effects import Prior


def at_edge(x: float, prior: Prior, margin: float) -> bool:
    """Returns whether x is closer to an edge than `margin` times the prior range, or outside.

    The null and the physical limits are no edges: a parameter may have these values.
    """
    slack = margin * (prior.high - prior.low)
    low = prior.low not in (prior.null, prior.physical[0]) and x < prior.low + slack
    high = prior.high not in (prior.null, prior.physical[1]) and x > prior.high - slack
    return low or high


def widened_prior(prior: Prior, factor: float) -> Prior:
    """Returns the prior with a range `factor` times as wide about the null.

    An end that is the null stays, and the range ends at the physical limits.
    """
    ends = (prior.null + factor * (end - prior.null) for end in (prior.low, prior.high))
    low, high = (float(np.clip(end, *prior.physical)) for end in ends)
    return prior._replace(low=low, high=high)


def edge_parameters(
    fit: Fit, entries: Sequence[Parameter], effects: Sequence[str], settings: SelectionSettings
) -> list[int]:
    """Returns the indices of fitted parameters of `effects` that are at an edge of their range.

    A parameter that does not score its effect counts only if the data determine the parameter.
    """
    scored = {i for group in scoring_entries(entries).values() for i in group}
    found = []
    for i in (int(i) for i in fit.free):
        p = entries[i]
        if p.effect in effects and at_edge(fit.theta[i], p.prior, settings.bound_margin):
            if i in scored or determined(p, *confidence_interval(fit, entries, i)[1:]):
                found.append(i)
    return found


def widen_ranges(
    found: Selection, fit: Fit, refit: Callable[[Fit, Sequence[Parameter]], Fit]
) -> Fit:
    """Returns `fit`, repeated with wider ranges if parameters of selected effects are at an edge.

    `refit` repeats a fit with other entries. The ranges in `found.entries` become wider, and
    `found.declared` keeps the declared ranges. Each range is widened once.
    """
    settings = found.settings
    edges = edge_parameters(fit, found.entries, found.effects, settings)
    edges = [i for i in edges if i not in found.declared]
    if not edges:
        return fit
    found.declared |= {i: found.entries[i].prior for i in edges}
    found.entries = [
        p._replace(prior=widened_prior(p.prior, settings.range_factor)) if i in edges else p
        for i, p in enumerate(found.entries)
    ]
    return refit(fit, found.entries)
