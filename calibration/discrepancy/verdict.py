"""What a search amounts to, in one of five words, and how far the residual is from its floor."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calibration.discrepancy.rounds import Search, scored
from calibration.inference.gauss_newton import Fit
from calibration.inference.noise import DISCREPANCY
from calibration.inference.problem import Problem
from calibration.model.extended import Parameter
from calibration.model.predict import CHANNELS
from slider_jax.effects.library import LIBRARY

FLOOR = 1.5
"""Mean square of a channel's white residual up to which it is at the floor: programs that agree
leave up to 1.3."""
EXPLAINED = 0.9
"""Share of what stood above the floor, in rms, that the effects must remove to be named where they
leave more than the floor."""

EDGE = 0.01
"""Share of the prior range from its end within which a parameter is at the edge."""

NOTHING, IDENTIFIED, CLASS = "nothing_missing", "identified", "class"
UNEXPLAINED, INCONCLUSIVE = "unexplained", "inconclusive"
NAMED = (IDENTIFIED, CLASS)
"""Verdicts after which effects are added to the model."""


class Excess(NamedTuple):
    """Mean squares of a channel's white residuals, all together and of every trial; NaN where it
    lacks the channel."""

    trials: np.ndarray
    all: float


def excess(problem: Problem, fit: Fit) -> dict[str, Excess]:
    """How far the residual of a fit stands above the noise, channel by channel; 1 is the floor."""
    white = problem.whiteners(fit.predicted)
    residuals = problem.residuals(fit.predicted, white)
    found = {}
    for channel in problem.channels:
        each = {i: r for (i, name), r in residuals.items() if name == channel}
        if each:
            squares = np.full(len(problem.records), np.nan)
            for i, r in each.items():
                squares[i] = np.mean(r**2)
            found[channel] = Excess(squares, float(np.mean(np.concatenate([*each.values()]) ** 2)))
    return found


def at_bounds(search: Search, entries: Sequence[Parameter]) -> list[str]:
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


def split(search: Search) -> list[str]:
    """Effects that enter at one place: one cause may be spread over them.

    One that takes the place of a law is not such a part of a cause.
    """
    kinds = {name: LIBRARY[name] for name in search.effects if not LIBRARY[name].instead}
    places = [kind.place() for kind in kinds.values()]
    return [name for name, kind in kinds.items() if places.count(kind.place()) > 1]


def explained(before: float, after: float) -> float:
    """Share of a channel's rms, less 1 for the floor, that is gone; of mean squares over noise."""
    stood, stands = (np.sqrt(max(x, 1.0)) - 1.0 for x in (before, after))
    return float((stood - stands) / stood) if stood > 0.0 else 0.0


def decide(
    search: Search,
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


def rms_errors(problem: Problem, predicted: list[np.ndarray]) -> dict[str, float]:
    """rms of measured less predicted of every channel, in its unit, all trials together."""
    found = {}
    for channel in problem.channels:
        row = CHANNELS.index(channel)
        apart = [
            (r.values[row] - y[row])[r.there(channel)]
            for r, y in zip(problem.records, predicted, strict=True)
            if r.has(channel)
        ]
        if apart:
            found[channel] = float(np.sqrt(np.mean(np.concatenate(apart) ** 2)))
    return found


def floors(problem: Problem, predicted: list[np.ndarray]) -> dict[str, float]:
    """The rms that noise, tare and the difference of correct programs leave in every channel."""
    found = {}
    for channel in problem.channels:
        row, parts = CHANNELS.index(channel), []
        for (i, name), noise in problem.noise.items():
            if name == channel:
                share = DISCREPANCY[channel] * float(np.std(predicted[i][row]))
                square = noise.white**2 + noise.slow**2 + noise.tare**2 + share**2
                parts.append((square, int(problem.records[i].there(channel).sum())))
        if parts:
            squares, counts = np.array(parts).T
            found[channel] = float(np.sqrt(np.average(squares, weights=counts)))
    return found
