"""Predicts a trial's readings, and their tangents (derivatives with respect to parameters)."""

from collections import defaultdict
from collections.abc import Hashable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from threading import Lock

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from calibration.model.extended import BASE, ExtendedModel, model_parameters
from slider_jax.batch.chunks import available_cores
from slider_jax.beam.grid import split_cells
from slider_jax.beam.parameters import Numerics
from slider_jax.channels import CHANNELS, recorded, recorded_series
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.pressures import Chambers, chamber_history, start_chambers
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import Carry, Snapshot, at_rest
from slider_jax.dynamics.time_schemes import SCHEMES, SDIRK2, Scheme
from slider_jax.effects import ActingPressure, Command, Flow, Readings
from slider_jax.effects.library import KNOWN_EFFECTS
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

BLOCK = 100
"""Time steps or samples per call of a compiled program. A long trial needs several calls."""
DIRECTIONS = 8
"""A call of a compiled program computes a multiple of this number of tangents."""
MOST_DIRECTIONS = 64
"""Largest number of tangents that one call computes. 64 tangents take twice the time of eight."""
LANES = 4
"""Number of trials in one batch."""
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


def _chunk(
    extended: ExtendedModel,
    theta,
    carry: Carry,
    chambers: Chambers,
    h,
    t0,
    numerics: Numerics,
    scheme: Scheme,
):
    """Returns ideal sensors' readings (BLOCK, channels) in the next steps, and the last state.

    `chambers` are the chambers at the ends of the stages of these steps.
    """

    def save(x: Snapshot):
        return jnp.stack([channel.observe(x) for channel in extended.channels])

    times = TimeGrid(h, BLOCK, t0)
    out = rollout(
        extended.at(theta),
        times,
        save,
        numerics,
        scheme,
        begin=carry,
        chambers=chambers,
        checkpoint=False,
    )
    return out.saved, out.final


def _chambers(extended: ExtendedModel, theta, begin: Chambers, times) -> Chambers:
    """Returns the chambers at `times[1:]` [s], from `begin` at `times[0]`."""
    return chamber_history(extended.at(theta), begin, times)


def _read(extended: ExtendedModel, theta, t, series):
    """Returns real sensors' readings (channels, n) from ideal readings `series` (n, channels)."""
    names = [channel.name for channel in extended.channels]
    true = dict(zip(names, series.T, strict=True))
    read = recorded_series(extended.at(theta).effects, t, true)
    return jnp.stack([read[name] for name in names])


def recorded_pressures(model: Model, t):
    """Returns the readings p_front and p_rear (2, n) [Pa] at evenly spaced times `t` (n,) [s]."""
    begin = start_chambers(model)
    front, rear = jnp.concatenate([begin.p[None], chamber_history(model, begin, t).p]).T
    zero = jnp.zeros_like(t)
    read = recorded(model.effects, Readings(t, front, rear, zero, zero, zero))
    return jnp.stack([read.p_front, read.p_rear])


def _along(function, arguments, directions):
    """Returns the value of function(*arguments), and the value's tangents along `directions`.

    Each array of `directions` has the axes of its argument after a first axis of directions.
    """
    dynamic, static = eqx.partition(arguments, eqx.is_inexact_array)

    def value(dynamic):
        out = function(*eqx.combine(dynamic, static))
        moving, fixed = eqx.partition(out, eqx.is_inexact_array)
        return moving, fixed

    def one(direction):
        return jax.jvp(value, (dynamic,), (direction,), has_aux=True)

    moving, tangents, fixed = jax.vmap(one, out_axes=(None, 0, None))(directions)
    return eqx.combine(moving, fixed), tangents


def _compiled_once(function):
    """Returns the compiled `function`; a thread waits while another thread compiles it.

    JAX compiles a program twice if two threads call it for the first time at the same time.
    """
    jitted, locks, ready = eqx.filter_jit(function), defaultdict(Lock), set()

    def call(*arguments):
        leaves, structure = jax.tree.flatten(arguments)
        key = (structure, *(np.shape(x) for x in leaves))
        if key in ready:
            return jitted(*arguments)
        with locks[key]:
            found = jitted(*arguments)
            ready.add(key)
        return found

    return call


def _lanes(function):
    """Returns the compiled batch of `function`, called as batch(static arguments, *arguments).

    The first axis of each array in `arguments` is the lane.
    """

    @_compiled_once
    def batch(static, *lanes):
        return eqx.filter_vmap(lambda *lane: function(*lane, *static))(*lanes)

    return batch


_begin = _lanes(lambda extended, theta, numerics: at_rest(extended.at(theta), numerics))
_advance = _lanes(_chunk)
_chamber_lanes = _lanes(_chambers)
_recorded = _lanes(_read)


@_compiled_once
def _begin_along(extended: ExtendedModel, theta, directions, numerics: Numerics):
    return _along(lambda x: at_rest(extended.at(x), numerics), (theta,), (directions,))


@_compiled_once
def _advance_along(extended: ExtendedModel, here, along, h, t0, numerics: Numerics, scheme: Scheme):
    """Returns (readings, last state) of `_chunk` at `here` = (theta, carry, chambers); tangents."""

    def function(theta, carry, chambers):
        return _chunk(extended, theta, carry, chambers, h, t0, numerics, scheme)

    return _along(function, here, along)


@_compiled_once
def _chambers_along(extended: ExtendedModel, theta, begin, times, d_theta, d_begin):
    def function(theta, begin):
        return _chambers(extended, theta, begin, times)

    return _along(function, (theta, begin), (d_theta, d_begin))


@_compiled_once
def _recorded_along(extended: ExtendedModel, theta, t, series, d_theta, d_series):
    return _along(lambda x, s: _read(extended, x, t, s), (theta, series), (d_theta, d_series))[1]


def _sample_grid(p: TrialPlan) -> np.ndarray:
    """Returns evenly spaced times [s] from 0 that include the sample times, in whole blocks."""
    at, block = p.at, BLOCK * p.scheme.stages
    spacing = divided_step(float(np.median(np.diff(at))), LONGEST_STEP)
    before = np.ceil(at[0] / spacing - 1e-9)
    needed = round((at[-1] - at[0]) / spacing) + int(before) + 1
    t = at[0] + spacing * (np.arange(-(-needed // block) * block + 1) - before)
    t[0] = 0.0
    return t


def _stage_times(p: TrialPlan, done: int) -> np.ndarray:
    """Returns the time [s] after `done` steps, and the times of the next block's stages."""
    steps = np.arange(done, done + BLOCK)[:, None] + np.asarray(p.scheme.nodes)
    return p.grid.h * np.concatenate([[done], steps.ravel()])


def _padded(t: np.ndarray, series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns times (N,) and series (..., N, channels), extended to one of few lengths N.

    Trials of similar lengths then use the same compiled program. Beyond its end, a series keeps its
    last value.
    """
    n = LEAST_LENGTH
    while n < len(t):
        n *= 2
    more = n - len(t)
    rest = t[-1] + (t[-1] - t[-2]) * np.arange(1.0, more + 1.0)
    width = [(0, 0)] * series.ndim
    width[-2] = (0, more)
    return np.concatenate([t, rest]), np.pad(series, width, mode="edge")


def _at_samples(p: TrialPlan, series: np.ndarray) -> np.ndarray:
    """Returns the `series` (..., channels, steps), interpolated to the trial's sample times."""
    flat = series[..., : p.grid.steps + 1].reshape(-1, p.grid.steps + 1).T
    found = sample_series(p.grid.times, flat, p.at, p.grid.edges).T
    return found.reshape(*series.shape[:-1], len(p.at))


def _sampled(p: TrialPlan, body: np.ndarray, pressures: np.ndarray) -> np.ndarray:
    """Returns readings (channels, samples) at the trial's sample times.

    `body` (channels, steps) are readings at the ends of steps; they are interpolated. `pressures`
    (channels, n) are readings of the pressures at the times of `_sample_grid`.
    """
    t = _sample_grid(p)
    # t[0] is set to 0, so only the first interval may differ from the other intervals.
    index = 1 + np.round((p.at - t[1]) / (t[2] - t[1])).astype(int)
    index = np.clip(index, 0, len(t) - 1)
    return np.concatenate([pressures[:2, index], _at_samples(p, body[2:])])


def predict_readings(p: TrialPlan, theta: np.ndarray) -> np.ndarray:
    """Returns the readings (channels, samples) of a trial. Readings after a failed step are NaN."""
    return _simulate([without_null_effects(p, theta)])[0]


def without_null_effects(p: TrialPlan, theta: np.ndarray) -> tuple[TrialPlan, np.ndarray]:
    """Returns the plan and the parameters of the base model if every effect is at its null.

    The readings are the same. The base model takes 0.6 of the time of the extended model with all
    effects (measured: 0.39 s instead of 0.68 s with the mesh `FINE`, 0.14 s instead of 0.25 s with
    the mesh `COARSE`).
    """
    entries = model_parameters(p.extended.effects)
    acts = [x.prior.null != t and not x.is_shape for x, t in zip(entries, theta, strict=True)]
    if any(acts[len(BASE) :]):
        return p, theta
    return replace(p, extended=replace(p.extended, effects=())), theta[: len(BASE)]


def predict_each(pairs: Sequence[tuple[TrialPlan, np.ndarray]]) -> list[np.ndarray]:
    """Returns `predict_readings(plan, theta)` for each pair.

    Trials whose models have the same structure are simulated in batches of `LANES`.
    """
    pairs = [without_null_effects(p, theta) for p, theta in pairs]
    kinds: dict[Hashable, list[int]] = {}
    for i, (p, _) in enumerate(pairs):
        leaves, kind = jax.tree.flatten((p.extended, p.numerics, p.scheme))
        kinds.setdefault((kind, *(np.shape(x) for x in leaves)), []).append(i)
    jobs = []
    for places in kinds.values():
        places.sort(key=lambda i: -pairs[i][0].grid.steps)
        jobs += [places[i : i + LANES] for i in range(0, len(places), LANES)]

    def work(job: list[int]) -> list[np.ndarray]:
        full = job + [job[-1]] * (LANES - len(job))
        return _simulate([pairs[i] for i in full])[: len(job)]

    found: dict[int, np.ndarray] = {}
    for job, readings in zip(jobs, on_all_cores(work, jobs), strict=True):
        found |= dict(zip(job, readings, strict=True))
    return [found[i] for i in range(len(pairs))]


def _simulate(pairs: Sequence[tuple[TrialPlan, np.ndarray]]) -> list[np.ndarray]:
    """Returns the readings (channels, samples) of trials that are simulated in one batch."""
    plans = [p for p, _ in pairs]
    first, lanes = plans[0], range(len(plans))
    extended = jax.tree.map(lambda *x: np.stack(x), *(p.extended for p in plans))
    theta = np.stack([x for _, x in pairs])
    h = np.array([p.grid.h for p in plans])
    begin = _begin((first.numerics,), extended, theta)

    def chambers(start: Chambers, times: list[np.ndarray]) -> Chambers:
        return _chamber_lanes((), extended, theta, start, np.stack(times))

    def advance(done: int, carry: Carry):
        there = chambers(carry.chambers, [_stage_times(p, done) for p in plans])
        static = (first.numerics, first.scheme)
        return _advance(static, extended, theta, carry, there, h, h * done)

    def read(t: list[np.ndarray], series: np.ndarray) -> np.ndarray:
        padded = [_padded(x, y) for x, y in zip(t, series, strict=True)]
        at, values = (np.stack(x) for x in zip(*padded, strict=True))
        return np.array(_recorded((), extended, theta, at, values))

    start = np.asarray(begin.chambers.p)[:, None]
    parts, carry = run_chunks(advance, begin, max(p.grid.steps for p in plans), BLOCK)
    body = np.concatenate([_with_pressures(start), *parts], axis=1)
    t = [p.grid.h * np.arange(body.shape[1]) for p in plans]
    body = read(t, body)
    for i, failed_at in zip(lanes, np.asarray(carry.failed_at), strict=True):
        body[i][:, : len(t[i])][:, t[i] >= failed_at - 0.5 * h[i]] = np.nan

    grids = [_sample_grid(p) for p in plans]
    block, state, pressures = BLOCK * first.scheme.stages, begin.chambers, [start]
    longest = max(len(x) for x in grids)
    grids = [_extended_grid(x, longest) for x in grids]
    for done in range(0, longest - 1, block):
        there = chambers(state, [x[done : done + block + 1] for x in grids])
        state = jax.tree.map(lambda x: x[:, -1], there)
        pressures.append(np.asarray(there.p))
    recorded_p = read(grids, _with_pressures(np.concatenate(pressures, axis=1)))
    return [_sampled(p, body[i], recorded_p[i]) for i, p in enumerate(plans)]


def _extended_grid(t: np.ndarray, n: int) -> np.ndarray:
    """Returns evenly spaced times, extended to `n` times."""
    return np.concatenate([t, t[-1] + (t[-1] - t[-2]) * np.arange(1.0, n - len(t) + 1.0)])


def _with_pressures(p: np.ndarray) -> np.ndarray:
    """Returns readings (..., channels) with the pressures `p` (..., 2); other channels are zero."""
    return np.pad(p, [(0, 0)] * (p.ndim - 1) + [(0, len(CHANNELS) - 2)])


def reading_tangents(p: TrialPlan, theta: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Returns tangents (k, channels, samples) of the readings along `directions` (k, entries).

    The tangents of all channels, also of the pressures, are interpolated between time steps.
    """

    def along(d):
        return _tangents_from(p, theta, d, _begin_along(p.extended, theta, d, p.numerics))

    return by_directions(along, directions, _moves_pressures(p.extended, directions))


def _moves_pressures(extended: ExtendedModel, directions: np.ndarray) -> np.ndarray:
    """Returns for each of the `directions` (k, entries) whether it changes a pressure."""
    moving = [
        issubclass(KNOWN_EFFECTS[x.effect], (Command, Flow, ActingPressure))
        if x.effect
        else x.name == "k"
        for x in model_parameters(extended.effects)
    ]
    return np.any(directions[:, moving] != 0.0, axis=1)


def compile_readings(p: TrialPlan, theta: np.ndarray) -> None:
    """Compiles the programs of `predict_each` for trials like `p`, by a short simulation."""
    _simulate([(_first_block(p), theta)] * LANES)


def compile_tangents(p: TrialPlan, theta: np.ndarray, directions: np.ndarray) -> None:
    """Compiles the programs of `reading_tangents` for `directions` (k, entries)."""
    order = np.argsort(_moves_pressures(p.extended, directions), kind="stable")
    reading_tangents(_first_block(p), theta, directions[order[-rows_per_call(len(order)) :]])


def _first_block(p: TrialPlan) -> TrialPlan:
    """Returns the first time steps of a trial, which one call of the programs simulates."""
    grid = replace(p.grid, steps=min(p.grid.steps, BLOCK))
    return replace(p, grid=grid, at=p.at[: max(3, int(np.sum(p.at <= BLOCK * grid.h)))])


def initial_state_tangents(
    p: TrialPlan, theta: np.ndarray, d_carry: Carry, initial: np.ndarray
) -> np.ndarray:
    """Returns tangents (k, channels, samples) with respect to initial states.

    `d_carry` are the tangents of the initial state; their first axis is the direction. `initial`
    (k, channels) are the tangents of the readings at t = 0. Tangents of pressures are 0.
    """
    none = np.zeros((len(initial), len(theta)))
    carry, _ = _begin_along(p.extended, theta, none, p.numerics)
    return _tangents_from(p, theta, none, (carry, d_carry), initial)


def _tangents_from(
    p: TrialPlan,
    theta: np.ndarray,
    d_theta: np.ndarray,
    state: tuple[Carry, Carry],
    initial: np.ndarray | None = None,
) -> np.ndarray:
    """Returns tangents (k, channels, samples) from an initial `state` and its tangents."""
    (begin, d_begin), h = state, np.asarray(p.grid.h)
    pressures_move = _moves_pressures(p.extended, d_theta).any()

    def chambers(carry: Carry, d_carry: Carry, times: np.ndarray) -> tuple[Chambers, Chambers]:
        here, along = carry.chambers, d_carry.chambers
        if pressures_move:
            return _chambers_along(p.extended, theta, here, times, d_theta, along)
        same = (p.extended, theta, here, times)
        lane = jax.tree.map(lambda x: np.stack([np.asarray(x)] * LANES), same)
        there = jax.tree.map(lambda x: x[0], _chamber_lanes((), *lane))
        zero = jax.tree.map(lambda x: np.zeros((len(d_theta), *x.shape)), there)
        return there, zero

    def advance(done: int, state):
        carry, d_carry = state
        there, d_there = chambers(carry, d_carry, _stage_times(p, done))
        (saved, carry), (d_saved, d_carry) = _advance_along(
            p.extended, (theta, carry, there), (d_theta, d_carry, d_there),
            h, h * done, p.numerics, p.scheme,
        )  # fmt: skip
        return (saved, d_saved), (carry, d_carry)

    parts, _ = run_chunks(advance, state, p.grid.steps, BLOCK)
    first = _with_pressures(np.asarray(d_begin.chambers.p)[:, None])
    first = first if initial is None else initial[:, None]
    start = _with_pressures(np.asarray(begin.chambers.p)[None])
    series = np.concatenate([start, *(x for x, _ in parts)])
    d_series = np.concatenate([first, *(x for _, x in parts)], axis=1)
    (at, series), (_, d_series) = (
        _padded(h * np.arange(len(series)), x) for x in (series, d_series)
    )
    read = np.asarray(_recorded_along(p.extended, theta, at, series, d_theta, d_series))
    return _at_samples(p, read)


def rows_per_call(k: int) -> int:
    """Returns the number of directions in each call that computes a part of `k` tangents."""
    calls = -(-k // MOST_DIRECTIONS)
    return DIRECTIONS * -(-k // (DIRECTIONS * calls))


def by_directions(function, directions: np.ndarray, kinds: np.ndarray | None = None) -> np.ndarray:
    """Returns `function(directions)` for `directions` (k, n), in calls of equal numbers of rows.

    The number of rows is a multiple of `DIRECTIONS`, so that few programs are compiled. Rows of the
    same kind, given by `kinds` (k,), are next to each other in these calls.
    """
    order = np.arange(len(directions)) if kinds is None else np.argsort(kinds, kind="stable")
    rows = rows_per_call(len(directions))
    padded = np.zeros((-(-len(directions) // rows), rows, directions.shape[1]))
    padded.reshape(-1, directions.shape[1])[: len(directions)] = directions[order]
    found = np.concatenate([np.asarray(function(block)) for block in padded])
    return found[np.argsort(order)]


def on_all_cores(work, items: list) -> list:
    """Returns `work(item)` for every item, in the order of `items`, with one thread per core."""
    with ThreadPoolExecutor(max_workers=available_cores()) as pool:
        return list(pool.map(work, items))


@contextmanager
def background_thread() -> Iterator[ThreadPoolExecutor]:
    """Yields one thread for work that may be dropped; work that has not begun at the end is."""
    pool = ThreadPoolExecutor(1)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
