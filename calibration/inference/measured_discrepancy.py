"""Measures the model-discretisation discrepancy of each channel from a fit.

The discrepancy of a channel is a fraction of the channel's predicted readings. If the experiment
declares no discrepancy, the larger of two estimates is used.

The first estimate is the model's own discretisation error. It is extrapolated from the readings of
two meshes (Richardson, L. F. (1911), Phil. Trans. R. Soc. A 210, 307-357). The lower limit of the
discrepancy is this error, multiplied by a safety factor.

The second estimate is the size of the error that repeats in each stride. It follows from the
residual by maximum likelihood. With the symbols

    s     estimated discrepancy,
    S     standard deviation of the predicted readings of a trial,
    B_j   curves over the stride, which repeat in each stride,

the repeating error of a trial is s S times the sum of c_j B_j. The coefficients c_j are independent
normal variables of unit variance. The curves B_j are scaled so that the error has the correlation
of `noise.discrepancy_correlation` between phases of the stride.

The matrix W whitens all noise except the repeating error. The rows of B are the curves B_j at the
times of the readings. Let g be the eigenvalues of S^2 (B W^T) (B W^T)^T, and z the components of
the whitened residual along the corresponding directions. The components are independent, and the
deviance D of the trial is

    variance of z_k = 1 + s^2 g_k,    D(s) = sum of log(1 + s^2 g_k) + z_k^2 / (1 + s^2 g_k)

The deviance is summed over the trials of the channel, and the measured s minimises this sum. The
noise model does not use the measured s but the largest s whose deviance exceeds the minimum by at
most `DEVIANCE`. This s is the upper end of the one-standard-error interval. The noise model is
therefore more likely to overestimate the discrepancy than to underestimate it.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from calibration.inference.noise import (
    DISCREPANCY_STRIDES,
    DISCREPANCY_TIME,
    Whitener,
    discrepancy_correlation,
    discrepancy_memory,
)
from calibration.inference.problem import AbstractProblem
from slider_jax.channels import Channel

ORDER = 2
"""Order of convergence of the readings with the number of cells and time steps. In sixteen trials,
the extrapolated error of a channel was 0.66 to 1.2 times the error that was found by a simulation
with twice the cells and time steps."""
SAFETY = 1.5
"""Factor on the extrapolated error, which can be 0.66 times the actual error. Without this factor,
the loop named stress relaxation of the tail in 50 simulated trials. The cause was the mesh error of
these trials."""
PHASE_STEP = 0.5 * DISCREPANCY_TIME
"""The curves B are piecewise constant in time. Approximate duration of a constant piece [s]."""
LONGEST_STRIDE = 2.56
"""If a trial's drive has no frequency or a longer period, only this duration [s] is examined."""
MOST_READINGS = 2600
"""At most this number of readings of a trial is examined."""
DEVIANCE = 1.0
"""Increase of the deviance above its minimum, at one standard error from the measured s. The
deviance is minus twice the log-likelihood, apart from a constant."""
GRID = np.concatenate([[0.0], np.geomspace(1e-3, 1.0, 241)])
"""Values of s at which the deviance is computed, as fractions of the channel's largest discrepancy
(`Channel.discrepancy`): 0, then 0.001 to 1 in steps of 3 %."""
LEAST_MODE = 1e-2
"""Without a repeating error, each component has unit variance. A component is omitted if the
channel's largest discrepancy increases this variance by at most this value."""
LEAST_FALL = 0.2
"""The loop repeats the fit with the measured discrepancies if the new discrepancy of a channel is
smaller than its discrepancy in the noise model by more than this fraction."""


class Discrepancy(NamedTuple):
    """Model-discretisation discrepancy of a channel, as a fraction of the channel's rms."""

    declared: float | None
    lower_limit: float
    """Lower limit: the model's own discretisation error, extrapolated from two meshes, multiplied
    by `SAFETY`."""
    measured: float | None
    """Most likely size of the error that repeats in each stride, measured from the residual. None:
    no residual of this channel was used."""
    used: float
    """Declared value. If no value is declared: the upper end of the one-standard-error interval of
    the measured value, or `lower_limit` if this is larger. Without a measured value, the channel's
    largest discrepancy (`Channel.discrepancy`) replaces the end of the interval."""


class SeriesError(NamedTuple):
    """Components of the repeating error in one trial and channel."""

    here: np.ndarray
    """Mask (n,) of the examined readings."""
    whiten: Whitener
    """Whitener for all noise except the discrepancy."""
    modes: np.ndarray
    """Eigenvectors (k, n) of unit length, in the space of whitened readings."""
    sizes: np.ndarray
    """Eigenvalues g (k,): increase of a component's variance by a discrepancy of 1."""

    def components(self, residual: np.ndarray) -> np.ndarray:
        """Returns the components z (k,) of a residual (n,)."""
        return self.modes @ self.whiten(residual[self.here])[0]


class DiscrepancyMeter:
    """Measures the discrepancies of the fits of one problem."""

    def __init__(self, problem: AbstractProblem, fine: list[np.ndarray], coarse: list[np.ndarray]):
        """`fine` and `coarse` are readings with the same parameters on both meshes."""
        self.problem = problem
        errors = discretisation_errors(problem, fine, coarse)
        self.lower_limits = {channel: SAFETY * x for channel, x in errors.items()}
        spans = problem.spans()

        def one(key: tuple[int, str]) -> tuple[tuple[int, str], SeriesError]:
            i, channel = key
            r = problem.records[i]
            row, there = r.row(channel), r.there(channel)
            swings = None if spans is None else spans[i][:, row, there]
            model = np.nan_to_num(fine[i][row][there])
            return key, _series_error(problem, key, r.t[there], model, swings)

        # Threads would compete with the threads of the linear algebra and take ten times as long.
        self._series = dict(
            one(key) for key in problem.noise if is_measured(problem.all_channels[key[1]])
        )

    def __call__(self, predicted: Sequence[np.ndarray]) -> dict[str, Discrepancy]:
        """Returns the discrepancy of each channel for the model's readings `predicted`."""
        parts: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
        for (i, channel), x in self._series.items():
            r, row = self.problem.records[i], self.problem.records[i].row(channel)
            z = x.components((r.values[row] - predicted[i][row])[r.there(channel)])
            if len(z) and np.isfinite(z).all():
                parts.setdefault(channel, []).append((x.sizes, z))
        return {c: self._discrepancy(c, parts.get(c, [])) for c in self.problem.discrepancies}

    def _discrepancy(self, channel: str, parts: list[tuple[np.ndarray, np.ndarray]]) -> Discrepancy:
        most = self.problem.all_channels[channel].discrepancy
        least = self.lower_limits.get(channel, 0.0)
        measured, upper = likely_error(parts, most) if parts else (None, most)
        declared = self.problem.declared.get(channel)
        used = max(upper, least) if declared is None else declared
        return Discrepancy(declared, least, measured, used)


def is_measured(channel: Channel) -> bool:
    """Returns whether the discrepancy of a channel is measured: it is not, for pressures.

    Both meshes have the same pressures, so there is no lower limit. Errors of the pressures may
    also have a period of several strides. With time steps of 0.2 ms at 6 Hz, for example, the
    period is three strides.
    """
    return channel.kind != "pressure"


def _series_error(
    problem: AbstractProblem,
    key: tuple[int, str],
    t: np.ndarray,
    model: np.ndarray,
    swings: np.ndarray | None,
) -> SeriesError:
    frequency, noise = problem.records[key[0]].trial.frequency, problem.noise[key]
    repeats = frequency is not None and frequency * LONGEST_STRIDE >= 1.0
    period = 1.0 / frequency if frequency and repeats else LONGEST_STRIDE
    late = t - t[0]
    here = late < period * (DISCREPANCY_STRIDES if repeats else 1.0)
    here &= np.arange(len(t)) < MOST_READINGS
    noise = noise._replace(discrepancy=0.0, white=np.broadcast_to(noise.white, t.shape)[here])
    whiten = Whitener(
        t[here], noise, model[here], frequency, None if swings is None else swings[:, here]
    )
    count = max(1, round(period / PHASE_STEP))
    step = np.minimum((late[here] % period / period * count).astype(int), count - 1)
    middle = (np.arange(count) + 0.5) * period / count
    gap = np.abs(middle[:, None] - middle)
    memory = discrepancy_memory(t, frequency)
    values, vectors = eigh(discrepancy_correlation(gap, frequency if repeats else None, memory))
    curves = float(np.std(model)) * np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    white = whiten(curves[:, step])
    sizes, turn = eigh(white @ white.T)
    kept = sizes * problem.all_channels[key[1]].discrepancy ** 2 > LEAST_MODE
    modes = turn[:, kept].T @ white / np.sqrt(sizes[kept])[:, None]
    return SeriesError(here, whiten, modes, sizes[kept])


def likely_error(
    parts: Sequence[tuple[np.ndarray, np.ndarray]], most: float
) -> tuple[float, float]:
    """Returns the measured s, and the largest s whose deviance is within `DEVIANCE` of the minimum.

    Both are at most `most`. The module's docstring defines s and the deviance. `parts` are the
    eigenvalues g (k,) and components z (k,) of each trial.
    """
    g, z = (np.concatenate(x) for x in zip(*parts, strict=True))
    variance = 1.0 + np.square(most * GRID)[:, None] * g
    deviance = np.sum(np.log(variance) + z**2 / variance, axis=1)
    within = np.flatnonzero(deviance <= deviance.min() + DEVIANCE)
    return most * float(GRID[np.argmin(deviance)]), most * float(GRID[within[-1]])


def discretisation_errors(
    problem: AbstractProblem, fine: Sequence[np.ndarray], coarse: Sequence[np.ndarray]
) -> dict[str, float]:
    """Returns the error of the fine mesh in each channel, as a fraction of the channel's rms.

    Richardson's extrapolation gives the error as (fine - coarse) / (ratio^p - 1) with the order p.
    A constant and a multiple of the readings are removed first, because tare and gain absorb both.
    The result is the median over the trials, so that a single outlying trial has no influence.
    """
    found: dict[str, list[float]] = {}
    for i, channel in problem.noise:
        row, there = problem.records[i].row(channel), problem.records[i].there(channel)
        y, other = fine[i][row][there], coarse[i][row][there]
        if np.isfinite(y).all() and np.isfinite(other).all() and np.std(y) > 0.0:
            columns = np.stack([np.ones_like(y), y], axis=1)
            rest = other - columns @ np.linalg.lstsq(columns, other, rcond=None)[0]
            found.setdefault(channel, []).append(float(np.std(rest) / np.std(y)))
    share = richardson_share(problem)
    return {channel: share * float(np.median(x)) for channel, x in found.items()}


def richardson_share(problem: AbstractProblem) -> float:
    """Returns the error of the fine mesh, divided by the difference between the two meshes."""
    return 1.0 / (problem.mesh_ratio**ORDER - 1.0)


def fell(found: Mapping[str, Discrepancy], before: Mapping[str, float]) -> bool:
    """Returns whether a discrepancy is clearly smaller than the value `before` in the noise."""
    return any(x.used < (1.0 - LEAST_FALL) * before[c] for c, x in found.items())
