"""How well a fit explains the data: its residual against the noise floor."""

from typing import NamedTuple

import numpy as np

from calibration.inference.gauss_newton import Fit
from calibration.inference.problem import AbstractProblem
from slider_jax.channels import CHANNELS, row_of


class Excess(NamedTuple):
    """Mean squares of a channel's white residuals, all together and of every trial; NaN where it
    lacks the channel."""

    trials: np.ndarray
    all: float


def excess(problem: AbstractProblem, fit: Fit) -> dict[str, Excess]:
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


def rms_errors(problem: AbstractProblem, predicted: list[np.ndarray]) -> dict[str, float]:
    """rms of measured less predicted of every channel, in its unit, all trials together."""
    found = {}
    for channel in problem.channels:
        row = row_of(channel)
        apart = [
            (r.values[row] - y[row])[r.there(channel)]
            for r, y in zip(problem.records, predicted, strict=True)
            if r.has(channel)
        ]
        if apart:
            found[channel] = float(np.sqrt(np.mean(np.concatenate(apart) ** 2)))
    return found


def floors(problem: AbstractProblem, predicted: list[np.ndarray]) -> dict[str, float]:
    """The rms that noise, tare and the difference of correct programs leave in every channel."""
    found = {}
    for channel in problem.channels:
        row, parts = row_of(channel), []
        for (i, name), noise in problem.noise.items():
            if name == channel:
                share = CHANNELS[channel].discrepancy * float(np.std(predicted[i][row]))
                square = noise.white**2 + noise.slow**2 + noise.tare**2 + share**2
                parts.append((square, int(problem.records[i].there(channel).sum())))
        if parts:
            squares, counts = np.array(parts).T
            found[channel] = float(np.sqrt(np.average(squares, weights=counts)))
    return found
