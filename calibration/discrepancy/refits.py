"""Refits of a model with one effect added, removed or substituted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.discrepancy.rounds import effect_entries, relative_changes
from calibration.discrepancy.settings import DEFAULT_SETTINGS, SelectionSettings
from calibration.inference.gauss_newton import Fit, fit_gauss_newton, inverse
from calibration.inference.noise import Whitener
from calibration.inference.problem import FAILED, AbstractProblem, summed
from calibration.model.extended import Parameter


def initial_theta(
    refits: "Refits", theta: np.ndarray, group: np.ndarray, step: np.ndarray
) -> np.ndarray:
    """Returns the parameter vector from which a refit with an additional effect starts.

    `group` are the indices of the effect's parameters. Parameters with a `Prior.start` start there.
    If no parameter has a start, the vector is `theta` plus the `step` of the effect's score.
    """
    entries = refits.entries
    starts = [i for i in group if entries[i].prior.start is not None]
    if starts:
        theta = theta.copy()
        theta[starts] = [entries[i].prior.start for i in starts]
        return theta
    low, high = np.array([[p.prior.low, p.prior.high] for p in entries]).T
    moved = np.where(step == 0.0, theta, np.clip(theta + step, low, high))
    still = group[moved[group] == theta[group]]
    moved[still] += refits.settings.initial_step_share * (high - low)[still]
    return moved


@dataclass(frozen=True)
class Refits:
    """Refits of one problem with fixed whiteners, so that their sums of squares are comparable."""

    problem: AbstractProblem
    entries: Sequence[Parameter]
    white: dict[tuple[int, str], Whitener]
    progress: Callable[[str], None]
    settings: SelectionSettings = DEFAULT_SETTINGS

    def sizes(self, before: Fit, after: Fit) -> dict[str, float]:
        """Returns each channel's rms change between two fits as a fraction of the channel's rms."""
        return relative_changes(self.problem.channels, before.predicted, after.predicted)

    def fit(self, theta: np.ndarray, free: np.ndarray) -> Fit:
        """Returns the fit of the parameters `free` (indices) that starts at `theta`."""
        return fit_gauss_newton(self.problem, self.entries, theta, free, self.progress, self.white)

    def null(self, theta: np.ndarray, group: np.ndarray) -> np.ndarray:
        """Returns theta with the parameters `group` (indices) at their null."""
        theta = theta.copy()
        theta[group] = [self.entries[i].prior.null for i in group]
        return theta

    def joined(self, theta: np.ndarray, start: np.ndarray, free: np.ndarray) -> Fit | None:
        """Returns the fit of the parameters `free` (indices) that starts at `start`.

        A start that cannot be simulated is moved halfway to `theta`. Returns None if
        `max_halvings` successive starts cannot be simulated.
        """
        for _ in range(self.settings.max_halvings):
            found = self.fit(start, free)
            if found.square < FAILED:
                return found
            start = 0.5 * (start + theta)
        return None

    def without(self, current: Fit, name: str) -> Fit | None:
        """Returns the fit without the effect `name`, or None if the effect is necessary."""
        group = effect_entries(self.entries)[name]
        own = np.isin(current.free, group)
        null = self.null(current.theta, group)
        away = (current.theta - null)[group][np.isin(group, current.free)]
        A = summed(current.blocks)[0]
        loss = away @ np.linalg.pinv(inverse(A)[np.ix_(own, own)]) @ away / current.inflation
        if not loss < self.settings.removal_loss_factor * self.settings.min_gain:
            return None
        self.progress(f"refitting without {name}")
        less = self.fit(null, current.free[~own])
        gain = (less.square - current.square) / current.inflation
        needed = self.settings.worth_naming(gain, self.sizes(less, current))
        return less if less.converged and not needed else None
