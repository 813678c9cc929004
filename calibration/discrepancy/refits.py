"""Fits of a model with an effect more, less, or in another's place, than one fitted already."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.discrepancy.rounds import LEAST_GAIN, groups, relative_changes, worth_naming
from calibration.inference.gauss_newton import Fit, fit_gauss_newton, inverse
from calibration.inference.noise import Whitener
from calibration.inference.problem import FAILED, AbstractProblem, summed
from calibration.model.extended import Parameter

HALVINGS = 4
"""Sizes that are tried of a start that cannot be simulated."""
SURE = 10.0
"""An effect is not taken out on trial whose loss would be so many times the least gain, as the
linearised model has it."""


def initial_theta(
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


@dataclass(frozen=True)
class Refits:
    """What all fits of a search share, so that their sums of squares compare."""

    problem: AbstractProblem
    entries: Sequence[Parameter]
    white: dict[tuple[int, str], Whitener]
    progress: Callable[[str], None]

    def sizes(self, before: Fit, after: Fit) -> dict[str, float]:
        """By what share of its rms every channel changes from one fit to another."""
        return relative_changes(self.problem.channels, before.predicted, after.predicted)

    def fit(self, theta: np.ndarray, free: np.ndarray) -> Fit:
        """The fit of the entries `free` from theta."""
        return fit_gauss_newton(self.problem, self.entries, theta, free, self.progress, self.white)

    def null(self, theta: np.ndarray, group: np.ndarray) -> np.ndarray:
        """theta with the entries `group` at their null."""
        theta = theta.copy()
        theta[group] = [self.entries[i].prior.null for i in group]
        return theta

    def joined(self, theta: np.ndarray, start: np.ndarray, free: np.ndarray) -> Fit | None:
        """The fit of the entries `free` from `start`, nearer to theta while that cannot be.

        None where it never can be simulated.
        """
        for _ in range(HALVINGS):
            found = self.fit(start, free)
            if found.square < FAILED:
                return found
            start = 0.5 * (start + theta)
        return None

    def without(self, current: Fit, name: str) -> Fit | None:
        """The fit without an effect, if it lacks nothing that is worth a name; else None."""
        group = groups(self.entries)[name]
        own = np.isin(current.free, group)
        null = self.null(current.theta, group)
        away = (current.theta - null)[group][np.isin(group, current.free)]
        A = summed(current.blocks)[0]
        loss = away @ np.linalg.pinv(inverse(A)[np.ix_(own, own)]) @ away / current.inflation
        if not loss < SURE * LEAST_GAIN:
            return None
        self.progress(f"refitting without {name}")
        less = self.fit(null, current.free[~own])
        gain = (less.square - current.square) / current.inflation
        needed = worth_naming(gain, self.sizes(less, current))
        return less if less.converged and not needed else None
