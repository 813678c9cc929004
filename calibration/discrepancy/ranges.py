"""Widens prior ranges in which a fit ends at an edge, and fixes undetermined shape parameters."""

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


def inside(
    theta: np.ndarray,
    step: np.ndarray,
    free: np.ndarray,
    entries: Sequence[Parameter],
    settings: SelectionSettings,
    share: float = 1.0,
) -> np.ndarray:
    """Returns theta + share step, with the entries `free` (indices) inside their prior ranges.

    A fit cannot leave a bound of a range. If the step of an entry ends at a bound or beyond, the
    entry is therefore set back by `initial_step_share` times `share` of its range.
    """
    found = theta + share * step
    for i in (int(i) for i in free if step[i] != 0.0):
        prior = entries[i].prior
        margin = share * settings.initial_step_share * (prior.high - prior.low)
        if found[i] <= prior.low:
            found[i] = prior.low + margin
        elif found[i] >= prior.high:
            found[i] = prior.high - margin
    return found


def widened_prior(prior: Prior, factor: float, is_shape: bool = False) -> Prior:
    """Returns the prior with a range `factor` times as wide about the null.

    An end that is equal to the null does not move, and the range ends at the physical limits. For a
    positive shape parameter, such as a time constant, the low end is divided by the factor instead.
    """
    low, high = (prior.null + factor * (end - prior.null) for end in (prior.low, prior.high))
    if is_shape and prior.low > 0.0:
        low = prior.low / factor
    low, high = (float(np.clip(end, *prior.physical)) for end in (low, high))
    return prior._replace(low=low, high=high)


def edge_parameters(
    fit: Fit, entries: Sequence[Parameter], effects: Sequence[str], settings: SelectionSettings
) -> list[int]:
    """Returns the indices of fitted parameters of `effects` that are at an edge of their range.

    If the score of an effect does not use a parameter, the function returns this parameter only if
    the data determine it.
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
        p._replace(prior=widened_prior(p.prior, settings.range_factor, p.is_shape))
        if i in edges
        else p
        for i, p in enumerate(found.entries)
    ]
    return refit(fit, found.entries)


def fix_undetermined_shapes(
    found: Selection, fit: Fit, refit: Callable[[Fit, Sequence[Parameter]], Fit]
) -> Fit:
    """Returns `fit`, repeated with undetermined shape parameters fixed at their defaults.

    The parameter with the widest interval is fixed first. A parameter stays free if the fit with
    its default is significantly worse, because the data then contradict the default. The
    function does not compute this fit if the predicted loss is far above the limit.
    """
    settings, entries, kept = found.settings, found.entries, set[int]()
    least = settings.least_gain(2) - settings.least_gain(1)
    while True:
        widths = {}
        for i in (int(i) for i in fit.free if entries[i].is_shape and int(i) not in kept):
            _, low, high = confidence_interval(fit, entries, i)
            if not determined(entries[i], low, high):
                widths[i] = (high - low) / (entries[i].prior.high - entries[i].prior.low)
        if not widths:
            return fit
        widest = max(widths, key=lambda i: widths[i])
        distance = entries[widest].prior.null - fit.theta[widest]
        covariance = fit.covariance[fit.free == widest][0]
        variance = covariance[fit.free == widest].item()
        if not distance**2 < settings.removal_loss_factor * least * variance < np.inf:
            kept.add(widest)
            continue
        # The other parameters start at their linear optimum for this default.
        step = np.zeros(len(fit.theta))
        step[fit.free] = distance * covariance / variance
        theta = inside(fit.theta, step, fit.free, entries, settings)
        theta[widest] = entries[widest].prior.null
        fixed = refit(
            fit._replace(theta=theta, free=fit.free[fit.free != widest], linearised_at=None),
            entries,
        )
        if fixed.converged and (fixed.square - fit.square) / fit.inflation < least:
            fit = fixed
        else:
            kept.add(widest)
