"""Plans the simulation of a trial with the extended model: mesh, time steps and sample times."""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from calibration.model.extended import ExtendedModel
from slider_jax.beam.grid import split_cells
from slider_jax.beam.parameters import Numerics
from slider_jax.channels import ChannelSet
from slider_jax.dynamics.time_schemes import SCHEMES, SDIRK2, Scheme
from slider_jax.experiment.load import Experiment, trial_conditions
from slider_jax.experiment.playback import LONGEST_STEP
from slider_jax.experiment.prepare import (
    PreparedTrial,
    StepGrid,
    divided_step,
    prepare,
    sample_series,
    step_grid,
)
from slider_jax.experiment.schema import Trial

BLOCK = 100
"""Time steps or samples per call of a compiled program. A long trial needs several calls."""
LEAST_LENGTH = 2048
"""Smallest length to which series are extended; all lengths are this length times 1, 2, 4, ..."""


@dataclass(frozen=True)
class Resolution:
    """Number of nodes, least number of time steps per stride, longest step [s], time scheme.

    In a fit, a resolution replaces the table [numerics] of the experiment file.
    """

    nodes: int
    per_stride: int
    step: float
    scheme: str = SDIRK2.name


FINE = Resolution(101, 200, 2.0e-3)
"""Resolution for residuals. With only 51 nodes, a fit returns a tail that is 2.5 % too soft."""
COARSE = Resolution(31, 80, 4.0e-3)
"""Resolution for tangents, whose allowed error is ten times the allowed error of residuals."""


@dataclass(frozen=True)
class TrialPlan:
    """Inputs for the simulation of one trial with the extended model."""

    trial: Trial
    extended: ExtendedModel
    numerics: Numerics
    scheme: Scheme
    grid: StepGrid
    at: np.ndarray
    """Sample times (n,) [s]."""


def plan_trial(
    experiment: Experiment,
    trial: Trial | PreparedTrial,
    effects: tuple[str, ...],
    resolution: Resolution,
    at: np.ndarray | None = None,
) -> TrialPlan:
    """Returns the model, mesh and time grid of a trial. Raises `InputError` for an invalid trial.

    `at` (n,) are the sample times [s] (default: from the data file). A prepared trial ignores `at`.
    """
    if isinstance(trial, PreparedTrial):
        prepared = trial
    else:
        prepared = prepare(experiment, trial, sample_times=at)
    trial, at = prepared.trial, prepared.sample_times
    robot = experiment.robot
    cells = split_cells(resolution.nodes, *robot.lengths)
    numerics = replace(prepared.numerics, tail_cells=cells[0], body_cells=cells[1])
    longest, spacing = resolution.step, None
    if trial.frequency is None:
        spacing = float(np.median(np.diff(at)))
    else:
        longest = min(longest, 1.0 / (trial.frequency * resolution.per_stride))
    delays = prepared.grid.delays
    grid = step_grid(trial, longest, at[-1], spacing, prepared.played, delays)
    taken = {name: jnp.asarray(x, float) for name, x in trial_conditions(experiment, trial).items()}
    extended = ExtendedModel(prepared.model, taken, effects, prepared.channels)
    return TrialPlan(trial, extended, numerics, SCHEMES[resolution.scheme], grid, at)


def first_block(p: TrialPlan) -> TrialPlan:
    """Returns the first time steps of a trial, which one call of the programs simulates."""
    grid = replace(p.grid, steps=min(p.grid.steps, BLOCK))
    return replace(p, grid=grid, at=p.at[: max(3, int(np.sum(p.at <= BLOCK * grid.h)))])


def stage_times(p: TrialPlan) -> np.ndarray:
    """Returns the time 0 and the times [s] of all stages, in whole blocks of time steps."""
    steps = np.arange(-(-p.grid.steps // BLOCK) * BLOCK)[:, None] + np.asarray(p.scheme.nodes)
    return p.grid.h * np.concatenate([[0.0], steps.ravel()])


def sample_grid(p: TrialPlan) -> np.ndarray:
    """Returns evenly spaced times [s] from 0 that include the sample times, in whole blocks."""
    at, block = p.at, BLOCK * p.scheme.stages
    spacing = divided_step(float(np.median(np.diff(at))), LONGEST_STEP)
    before = np.ceil(at[0] / spacing - 1e-9)
    needed = round((at[-1] - at[0]) / spacing) + int(before) + 1
    t = at[0] + spacing * (np.arange(-(-needed // block) * block + 1) - before)
    t[0] = 0.0
    return t


def extended_grid(t: np.ndarray, n: int) -> np.ndarray:
    """Returns the times `t`, extended to `n` times with the last spacing of `t`."""
    return np.concatenate([t, t[-1] + (t[-1] - t[-2]) * np.arange(1.0, n - len(t) + 1.0)])


def padded_times(t: np.ndarray) -> np.ndarray:
    """Returns the times `t`, extended to one of few lengths N.

    Trials of similar lengths then use the same compiled program.
    """
    n = LEAST_LENGTH
    while n < len(t):
        n *= 2
    return extended_grid(t, n)


def padded(t: np.ndarray, series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns `padded_times` (N,), and the series (..., N, channels) at these times.

    Beyond its end, a series keeps its last value.
    """
    long = padded_times(t)
    width = [(0, 0)] * series.ndim
    width[-2] = (0, len(long) - len(t))
    return long, np.pad(series, width, mode="edge")


def at_samples(p: TrialPlan, series: np.ndarray) -> np.ndarray:
    """Returns the `series` (..., channels, steps), interpolated to the trial's sample times."""
    flat = series[..., : p.grid.steps + 1].reshape(-1, p.grid.steps + 1).T
    found = sample_series(p.grid.times, flat, p.at, p.grid.edges).T
    return found.reshape(*series.shape[:-1], len(p.at))


def sampled(p: TrialPlan, body: np.ndarray, pressures: np.ndarray) -> np.ndarray:
    """Returns readings (channels, samples) at the trial's sample times.

    `body` (channels, steps) are readings at the ends of steps; they are interpolated. `pressures`
    (channels, n) are readings at the times of `sample_grid`; only the pressures are used.
    """
    t = sample_grid(p)
    # t[0] is set to 0, so only the first interval may differ from the other intervals.
    index = 1 + np.round((p.at - t[1]) / (t[2] - t[1])).astype(int)
    index = np.clip(index, 0, len(t) - 1)
    channels, found = p.extended.channels, np.empty((len(body), len(p.at)))
    rows = channels.rows(channels.pressures)
    others = np.setdiff1d(np.arange(len(channels)), rows)
    found[rows], found[others] = pressures[rows][:, index], at_samples(p, body[others])
    return found


def extrapolate_start(channels: ChannelSet, series: np.ndarray) -> None:
    """Sets the first readings in `series` (..., n, channels) of channels without a known start."""
    rows = channels.rows(channels.without_start)
    series[..., 0, rows] = 2.0 * series[..., 1, rows] - series[..., 2, rows]


def with_pressures(channels: ChannelSet, p: np.ndarray) -> np.ndarray:
    """Returns readings (..., channels) with the pressures `p` (..., chambers).

    The other channels are zero.
    """
    readings = np.zeros((*p.shape[:-1], len(channels)))
    readings[..., channels.rows(channels.pressures)] = p
    return readings
