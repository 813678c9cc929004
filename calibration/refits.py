"""Fits of a model with one effect more, or one less, than a model that is fitted already."""

from collections.abc import Callable, Sequence

import numpy as np

from calibration.evidence import FAILED, Problem, summed
from calibration.fit import Fit, fit, inverse
from calibration.noise import Whitener
from calibration.plant import Parameter
from calibration.rounds import LEAST_GAIN, sizes_of, worth_naming

HALVINGS = 4
"""Sizes that are tried of a start that cannot be simulated."""
SURE = 10.0
"""An effect is not taken out on trial whose loss would be so many times the least gain, as the
linearised model has it."""
White = dict[tuple[int, str], Whitener]
Say = Callable[[str], None]


def begun(
    entries: Sequence[Parameter], theta: np.ndarray, group: np.ndarray, step: np.ndarray
) -> np.ndarray:
    """Where the refit with an effect begins: at its starts, or a score's `step` from theta."""
    starts = [i for i in group if entries[i].prior.start is not None]
    if starts:
        theta = theta.copy()
        theta[starts] = [entries[i].prior.start for i in starts]
        return theta
    low, high = np.array([[p.prior.low, p.prior.high] for p in entries]).T
    moved = np.where(step == 0.0, theta, np.clip(theta + step, low, high))
    still = group[moved[group] == theta[group]]
    moved[still] += 0.02 * (high - low)[still]
    return moved


def joined(
    problem: Problem,
    entries: Sequence[Parameter],
    theta: np.ndarray,
    start: np.ndarray,
    free: np.ndarray,
    white: White,
    progress: Say,
) -> Fit | None:
    """The fit of the entries `free` from `start`, nearer to theta where that cannot be simulated.

    None where it never can.
    """
    for _ in range(HALVINGS):
        found = fit(problem, entries, start, free, progress, white)
        if found.square < FAILED:
            return found
        start = 0.5 * (start + theta)
    return None


def without(
    problem: Problem,
    entries: Sequence[Parameter],
    current: Fit,
    group: np.ndarray,
    name: str,
    white: White,
    progress: Say,
) -> Fit | None:
    """The fit without an effect, if it lacks nothing that is worth a name; else None."""
    null = np.array([entries[i].prior.null for i in group])
    own = np.isin(current.free, group)
    away = (current.theta[group] - null)[np.isin(group, current.free)]
    A = summed(current.blocks)[0]
    loss = away @ np.linalg.pinv(inverse(A)[np.ix_(own, own)]) @ away / current.inflation
    if not loss < SURE * LEAST_GAIN:
        return None
    progress(f"refitting without {name}")
    theta = current.theta.copy()
    theta[group] = null
    less = fit(problem, entries, theta, current.free[~own], progress, white)
    gain = (less.square - current.square) / current.inflation
    needed = worth_naming(gain, sizes_of(problem, less, current))
    return less if less.converged and not needed else None
