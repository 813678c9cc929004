"""Compares the residual of a fit with the noise floor."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from calibration.inference.gauss_newton import Fit
from calibration.inference.problem import AbstractProblem
from calibration.inference.whiteness import SeriesTest, whiteness_tests


class Excess(NamedTuple):
    """Mean squares of a channel's whitened residuals, and tests of their whiteness."""

    trials: np.ndarray
    """Mean square (trials,) of every trial, or NaN if the trial does not have this channel."""
    all: float
    """Mean square of all trials together."""
    series: tuple[SeriesTest, ...] = ()
    """Tests of the channel's whitened residual in every trial."""

    @property
    def patterns(self) -> tuple[SeriesTest, ...]:
        """Returns the tests that found a line or a correlation that is large enough to matter."""
        return tuple(x for x in self.series if x.has_line or x.correlated)

    def above(self, noise_floor: float) -> bool:
        """Returns whether the residual exceeds the mean square `noise_floor` or has a pattern."""
        return self.all > noise_floor or bool(self.patterns)


def whitened_residuals(problem: AbstractProblem, fit: Fit) -> dict[tuple[int, str], np.ndarray]:
    """Returns the whitened residual (n,) of a fit for each trial (index) and channel."""
    return problem.residuals(fit.predicted, problem.whiteners(fit.predicted))


def excess(
    problem: AbstractProblem, fit: Fit, residuals: dict[tuple[int, str], np.ndarray] | None = None
) -> dict[str, Excess]:
    """Returns the mean squares of each channel's whitened residuals. Noise alone would give 1.

    `residuals` are the `whitened_residuals` of the fit, if they are known.
    """
    residuals = whitened_residuals(problem, fit) if residuals is None else residuals
    found = {}
    for channel in problem.channels:
        each = {
            i: r / np.sqrt(problem.noise[i, channel].mean_square)
            for (i, name), r in residuals.items()
            if name == channel
        }
        if each:
            squares = np.full(len(problem.records), np.nan)
            for i, r in each.items():
                squares[i] = np.mean(r**2)
            found[channel] = Excess(squares, float(np.mean(np.concatenate([*each.values()]) ** 2)))
    return found


def tested_excess(problem: AbstractProblem, fit: Fit) -> dict[str, Excess]:
    """Returns `excess` with the tests of whiteness."""
    residuals = whitened_residuals(problem, fit)
    tests = whiteness_tests(problem.records, fit.predicted, residuals, problem.discrepancies)
    return {
        c: x._replace(series=tuple(s for s in tests if s.channel == c))
        for c, x in excess(problem, fit, residuals).items()
    }


def rms_errors(problem: AbstractProblem, predicted: list[np.ndarray]) -> dict[str, float]:
    """Returns each channel's rms error over all trials, in the unit of the channel."""
    found = {}
    for channel in problem.channels:
        row = problem.all_channels.row(channel)
        errors = [
            (r.values[row] - y[row])[r.there(channel)]
            for r, y in zip(problem.records, predicted, strict=True)
            if r.has(channel)
        ]
        if errors:
            found[channel] = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    return found


def channel_errors(
    problem: AbstractProblem, before: list[np.ndarray], after: list[np.ndarray]
) -> dict[str, dict[str, float]]:
    """Returns each channel's rms errors of two predictions, and its noise floor, in its unit."""
    start, end = rms_errors(problem, before), rms_errors(problem, after)
    floor = noise_floors(problem, after)
    return {c: {"before": start[c], "after": end[c], "floor": floor[c]} for c in end}


def excess_removed(errors: Mapping[str, Mapping[str, float]]) -> float | None:
    """Returns the fraction of the excess error that a model removes.

    The excess error is the rms error above the noise floor. `errors` is the result of
    `channel_errors`. Squared errors are divided by the squared noise floor and added over the
    channels. Returns None if no error before is above the noise floor.
    """
    before, after = (
        sum(max((x[key] / x["floor"]) ** 2 - 1.0, 0.0) for x in errors.values())
        for key in ("before", "after")
    )
    return 1.0 - float(np.sqrt(after / before)) if before > 0.0 else None


def noise_floors(problem: AbstractProblem, predicted: list[np.ndarray]) -> dict[str, float]:
    """Returns the noise floor of every channel, in its unit.

    The noise floor is the rms of noise, tare and model-discretisation discrepancy together.
    """
    found = {}
    for channel in problem.channels:
        row, parts = problem.all_channels.row(channel), []
        for (i, name), noise in problem.noise.items():
            if name == channel:
                share = noise.discrepancy * float(np.std(predicted[i][row]))
                white = float(np.mean(np.square(noise.white)))
                square = white + noise.slow**2 + noise.tare**2 + share**2
                parts.append((square, int(problem.records[i].there(channel).sum())))
        if parts:
            squares, counts = np.array(parts).T
            found[channel] = float(np.sqrt(np.average(squares, weights=counts)))
    return found
