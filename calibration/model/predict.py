"""Predicts a trial's readings, and their tangents (derivatives with respect to parameters)."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from calibration.model.extended import ExtendedModel
from slider_jax.batch.chunks import available_cores
from slider_jax.beam.grid import split_cells
from slider_jax.beam.parameters import Numerics
from slider_jax.channels import recorded, recorded_series
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.pressures import chamber_history, start_chambers
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import Carry, Snapshot, at_rest
from slider_jax.dynamics.time_schemes import SCHEMES, SDIRK2, Scheme
from slider_jax.effects import Readings
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
from slider_jax.simulation.trial import run_chunks

BLOCK = 500
"""Time steps or samples per call of a compiled program. A long trial needs several calls."""
DIRECTIONS = 8
"""Number of tangents that one call of a compiled program computes."""


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
"""Resolution for tangents. The allowed error of tangents is ten times that of residuals."""


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
    cells = split_cells(resolution.nodes, robot.tail_length, robot.body_length)
    numerics = replace(prepared.numerics, tail_cells=cells[0], body_cells=cells[1])
    longest, spacing = resolution.step, None
    if trial.frequency is None:
        spacing = float(np.median(np.diff(at)))
    else:
        longest = min(longest, 1.0 / (trial.frequency * resolution.per_stride))
    grid = step_grid(trial, longest, at[-1], spacing, prepared.played)
    taken = {name: jnp.asarray(x, float) for name, x in trial_conditions(experiment, trial).items()}
    extended = ExtendedModel(prepared.model, taken, effects, prepared.channels)
    return TrialPlan(trial, extended, numerics, SCHEMES[resolution.scheme], grid, at)


def _chunk(extended: ExtendedModel, theta, carry: Carry, h, t0, numerics: Numerics, scheme: Scheme):
    """Returns ideal sensors' readings (BLOCK, channels) in the next steps, and the last state."""

    def save(x: Snapshot):
        return jnp.stack([channel.observe(x) for channel in extended.channels])

    times = TimeGrid(h, BLOCK, t0)
    out = rollout(extended.at(theta), times, save, numerics, scheme, begin=carry, checkpoint=False)
    return out.saved, out.final


def _read(extended: ExtendedModel, theta, t, series):
    """Returns real sensors' readings (channels - 2, n) without pressures, from ideal readings."""
    names = [channel.name for channel in extended.channels]
    true = dict(zip(names, series.T, strict=True))
    read = recorded_series(extended.at(theta).effects, t, true)
    return jnp.stack([read[name] for name in names[2:]])


def recorded_pressures(model: Model, t):
    """Returns the readings p_front and p_rear (2, n) [Pa] at evenly spaced times `t` (n,) [s]."""
    begin = start_chambers(model)
    front, rear = jnp.concatenate([begin.p[None], chamber_history(model, begin, t).p]).T
    zero = jnp.zeros_like(t)
    read = recorded(model.effects, Readings(t, front, rear, zero, zero, zero))
    return jnp.stack([read.p_front, read.p_rear])


def _pressures(extended: ExtendedModel, theta, t):
    return recorded_pressures(extended.at(theta), t)


def _along(function, arguments, directions):
    """Returns the tangents of function(*arguments) along `directions`.

    Each array of `directions` has the axes of its argument after a first axis of directions.
    """
    dynamic, static = eqx.partition(arguments, eqx.is_inexact_array)

    def value(dynamic):
        out = function(*eqx.combine(dynamic, static))
        return eqx.filter(out, eqx.is_inexact_array)

    return jax.vmap(lambda d: jax.jvp(value, (dynamic,), (d,))[1])(directions)


@eqx.filter_jit
def _begin(extended: ExtendedModel, theta, numerics: Numerics) -> Carry:
    return at_rest(extended.at(theta), numerics)


_advance = eqx.filter_jit(_chunk)
_recorded = eqx.filter_jit(_read)
_chambers = eqx.filter_jit(_pressures)


@eqx.filter_jit
def _begin_along(extended: ExtendedModel, theta, directions, numerics: Numerics):
    return _along(lambda x: at_rest(extended.at(x), numerics), (theta,), (directions,))


@eqx.filter_jit
def _advance_along(
    extended: ExtendedModel, theta, carry, d_theta, d_carry, h, t0, numerics, scheme
):
    def function(theta, carry):
        return _chunk(extended, theta, carry, h, t0, numerics, scheme)

    return function(theta, carry)[1], _along(function, (theta, carry), (d_theta, d_carry))


@eqx.filter_jit
def _recorded_along(extended: ExtendedModel, theta, t, series, d_theta, d_series):
    return _along(lambda x, s: _read(extended, x, t, s), (theta, series), (d_theta, d_series))


@eqx.filter_jit
def _chambers_along(extended: ExtendedModel, theta, t, d_theta):
    return _along(lambda x: _pressures(extended, x, t), (theta,), (d_theta,))


def _sample_grid(at: np.ndarray) -> np.ndarray:
    """Returns evenly spaced times [s] from 0 that include `at`, in whole blocks of `BLOCK`."""
    spacing = divided_step(float(np.median(np.diff(at))), LONGEST_STEP)
    before = np.ceil(at[0] / spacing - 1e-9)
    n = -(-(round((at[-1] - at[0]) / spacing) + int(before) + 2) // BLOCK) * BLOCK
    t = at[0] + spacing * (np.arange(n) - before)
    t[0] = 0.0
    return t


def _sampled(p: TrialPlan, body: np.ndarray, pressures: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Returns readings (..., channels, samples) at the trial's sample times.

    `body` (..., channels - 2, steps) are readings without pressures, interpolated between steps.
    `pressures` (..., 2, n) are at the times `t` (n,) [s], which include the sample times.
    """
    lead = body.shape[:-2]
    flat = body.reshape(-1, body.shape[-1])[:, : p.grid.steps + 1].T
    at_samples = sample_series(p.grid.times, flat, p.at, p.grid.edges).T.reshape(
        *lead, -1, len(p.at)
    )
    # t[0] is set to 0, so only the first interval may differ from the other intervals.
    index = 1 + np.round((p.at - t[1]) / (t[2] - t[1])).astype(int)
    index = np.clip(index, 0, len(t) - 1)
    return np.concatenate([pressures[..., index], at_samples], axis=-2)


def predict_readings(p: TrialPlan, theta: np.ndarray) -> np.ndarray:
    """Returns the readings (channels, samples) of a trial. Readings after a failed step are NaN."""
    series, failed_at = _series(p, jnp.asarray(theta))
    t = p.grid.h * np.arange(len(series))
    read = np.array(_recorded(p.extended, jnp.asarray(theta), jnp.asarray(t), series))
    read[:, t >= failed_at - 0.5 * p.grid.h] = np.nan
    grid = _sample_grid(p.at)
    pressures = _chambers(p.extended, jnp.asarray(theta), jnp.asarray(grid))
    return _sampled(p, read, np.asarray(pressures), grid)


def _series(p: TrialPlan, theta) -> tuple[Array, float]:
    """Returns readings (n, channels) of ideal sensors, and the time [s] of a failed step or inf."""
    carry = _begin(p.extended, theta, p.numerics)
    start = jnp.concatenate([carry.chambers.p, jnp.zeros(len(p.extended.channels) - 2)])[None]
    h = jnp.asarray(p.grid.h)

    def advance(done: int, carry: Carry):
        t0 = jnp.asarray(p.grid.h * done)
        return _advance(p.extended, theta, carry, h, t0, p.numerics, p.scheme)

    parts, carry = run_chunks(advance, carry, p.grid.steps, BLOCK)
    return jnp.concatenate([start, *parts]), float(carry.failed_at)


def reading_tangents(p: TrialPlan, theta: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Returns tangents (k, channels, samples) of the readings along `directions` (k, entries)."""
    at, grid = jnp.asarray(theta), _sample_grid(p.at)
    series, _ = _series(p, at)
    t = jnp.asarray(p.grid.h * np.arange(len(series)))

    def along(d):
        read = _recorded_along(p.extended, at, t, series, d, _series_along(p, at, d))
        pressures = _chambers_along(p.extended, at, jnp.asarray(grid), d)
        return _sampled(p, np.asarray(read), np.asarray(pressures), grid)

    return by_directions(along, directions)


def by_directions(function, directions: np.ndarray) -> np.ndarray:
    """Returns `function(directions)` for `directions` (k, n), with `DIRECTIONS` rows per call."""
    padded = np.zeros((-(-len(directions) // DIRECTIONS), DIRECTIONS, directions.shape[1]))
    padded.reshape(-1, directions.shape[1])[: len(directions)] = directions
    found = [np.asarray(function(jnp.asarray(block))) for block in padded]
    return np.concatenate(found)[: len(directions)]


def initial_state_tangents(
    p: TrialPlan, theta: np.ndarray, d_carry: Carry, initial: np.ndarray
) -> np.ndarray:
    """Returns tangents (`DIRECTIONS`, channels, samples) with respect to initial states.

    `d_carry` are the tangents of the initial state; their first axis is the direction. `initial`
    (`DIRECTIONS`, channels) are the tangents of the readings at t = 0. Tangents of pressures are 0.
    """
    at = jnp.asarray(theta)
    series, _ = _series(p, at)
    t, none = jnp.asarray(p.grid.h * np.arange(len(series))), jnp.zeros((DIRECTIONS, len(theta)))
    d_series = _carried_along(p, at, none, d_carry).at[:, 0].set(initial)
    read = np.asarray(_recorded_along(p.extended, at, t, series, none, d_series))
    grid = _sample_grid(p.at)
    return _sampled(p, read, np.zeros((DIRECTIONS, 2, len(grid))), grid)


def _series_along(p: TrialPlan, theta, d_theta) -> Array:
    """Returns the tangents (directions, n, channels) of `_series`."""
    return _carried_along(p, theta, d_theta, _begin_along(p.extended, theta, d_theta, p.numerics))


def _carried_along(p: TrialPlan, theta, d_theta, d_carry) -> Array:
    others = len(p.extended.channels) - 2
    start = jnp.pad(d_carry.chambers.p, ((0, 0), (0, others)))[:, None]
    h = jnp.asarray(p.grid.h)

    def advance(done: int, state):
        carry, d_carry = state
        t0 = jnp.asarray(p.grid.h * done)
        carry, (d_saved, d_carry) = _advance_along(
            p.extended, theta, carry, d_theta, d_carry, h, t0, p.numerics, p.scheme
        )
        return d_saved, (carry, d_carry)

    state = _begin(p.extended, theta, p.numerics), d_carry
    parts, _ = run_chunks(advance, state, p.grid.steps, BLOCK)
    return jnp.concatenate([start, *parts], axis=1)


def on_all_cores(work, items: list) -> list:
    """Returns `work(item)` for every item, in the order of `items`, with one thread per core."""
    with ThreadPoolExecutor(max_workers=available_cores()) as pool:
        return list(pool.map(work, items))
