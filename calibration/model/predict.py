"""Predicts the readings of trials in three parts: pressures, robot and water, and sensors.

The motion of the robot does not change the pressures, and the sensors do not change the motion.
Each part has its own program, which contains only the effects of this part. If all effects of a
part are at their null, the part's program contains no effect.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from calibration.model.compiled import (
    LONG,
    compiled_batch,
    in_batches,
    slices,
    stacked,
    structure_of,
)
from calibration.model.extended import ExtendedModel, Part, PartialModel, acting_part, whole_part
from calibration.model.plan import (
    BLOCK,
    TrialPlan,
    extended_grid,
    extrapolate_start,
    first_block,
    padded,
    sample_grid,
    sampled,
    stage_times,
    with_pressures,
)
from slider_jax.beam.parameters import Numerics
from slider_jax.channels import recorded
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.pressures import Chambers, chamber_history, start_chambers
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import Carry, Snapshot, at_rest
from slider_jax.dynamics.time_schemes import Scheme
from slider_jax.effects import Readings
from slider_jax.programs import return_freed_memory
from slider_jax.simulation.trial import run_chunks

BATCH = 4
"""Number of trials in one batch."""
SINGLE_CELLS = 60
"""Meshes with at least this number of cells are simulated one trial at a time. A batch of four
halves the time per trial with the mesh `COARSE`, but saves only 10 % with the mesh `FINE`. A batch
that is not full, or whose trials have different lengths, loses more than 10 %."""

PartOf = Callable[[ExtendedModel, Part, np.ndarray], PartialModel]
"""Returns the model with the effects of one part: `acting_part` or `whole_part`."""


class PressureHistory(NamedTuple):
    """The pressures of a simulated trial."""

    p: np.ndarray
    """Pressures (n, chambers) [Pa] at the start and at all stages of the time steps."""
    acting: np.ndarray
    """Pressures (n, chambers) [Pa] that bend the robot, at the same times."""
    sampled: np.ndarray
    """Pressures (n, chambers) [Pa] at the times of `sample_grid`."""

    def block(self, done: int, stages: int) -> Chambers:
        """Returns the chambers at the `stages` of the block that begins after `done` steps.

        After the end of the trial, the pressures stay constant.
        """
        rows = np.minimum(1 + done * stages + np.arange(BLOCK * stages), len(self.p) - 1)
        return Chambers(jnp.asarray(self.p[rows]), jnp.asarray(self.acting[rows]))


def advance_block(
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
        return jnp.stack([*extended.channels.observe(x).values()])

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


def begin_at_rest(extended: ExtendedModel, theta, numerics: Numerics) -> Carry:
    """Returns the state of the robot at rest at the start of a trial."""
    return at_rest(extended.at(theta), numerics)


def advance_chambers(extended: ExtendedModel, theta, begin: Chambers, times) -> Chambers:
    """Returns the chambers at `times[1:]` [s], from `begin` at `times[0]`."""
    return chamber_history(extended.at(theta), begin, times)


def read_series(extended: ExtendedModel, theta, t, series):
    """Returns real sensors' readings (channels, n) from ideal readings `series` (n, channels)."""
    channels = extended.channels
    true = dict(zip(channels, series.T, strict=True))
    read = channels.recorded(extended.at(theta).effects, t, true)
    return jnp.stack([read[name] for name in channels])


def recorded_pressures(model: Model, t):
    """Returns the readings (chambers, n) [Pa] of the pressures at evenly spaced times `t` [s]."""
    begin = start_chambers(model)
    p = jnp.concatenate([begin.p[None], chamber_history(model, begin, t).p]).T
    zero = jnp.zeros_like(t)
    return recorded(model.effects, Readings(t, p, zero, zero, zero)).pressures


_begin = compiled_batch(begin_at_rest)
_advance = compiled_batch(advance_block)
_chambers = compiled_batch(advance_chambers)
_read = compiled_batch(read_series)


def predict_readings(p: TrialPlan, theta: np.ndarray) -> np.ndarray:
    """Returns the readings (channels, samples) of a trial. Readings after a failed step are NaN."""
    return predict_each([(p, theta)])[0]


def predict_each(pairs: Sequence[tuple[TrialPlan, np.ndarray]]) -> list[np.ndarray]:
    """Returns `predict_readings(plan, theta)` for each pair, computed on all cores."""
    found = _predict(pairs, acting_part)
    if any(p.grid.steps >= LONG for p, _ in pairs):
        return_freed_memory()
    return found


def compile_readings(p: TrialPlan, theta: np.ndarray) -> None:
    """Compiles the programs of `predict_each` for trials like `p`, by a short simulation.

    The programs contain all effects of the model, also effects at their null.
    """
    _predict([(first_block(p), theta)] * batch_size(p), whole_part)


def _predict(pairs: Sequence[tuple[TrialPlan, np.ndarray]], part_of: PartOf) -> list[np.ndarray]:
    histories = pressure_histories(pairs, part_of)
    bodies = body_readings(pairs, histories, part_of)
    values = [
        len(p.extended.channels) * (len(x.series) + len(h.sampled))
        for (p, _), h, x in zip(pairs, histories, bodies, strict=True)
    ]
    found = []
    for here in slices(len(pairs), max(values, default=0)):  # limits the memory of long trials
        found += _sensor_readings(pairs[here], histories[here], bodies[here], part_of)
    return found


def pressure_histories(
    pairs: Sequence[tuple[TrialPlan, np.ndarray]], part_of: PartOf = acting_part
) -> list[PressureHistory]:
    """Returns the pressures of each pair. Pairs with the same pressures share one simulation."""
    parts = [part_of(p.extended, Part.PRESSURES, theta) for p, theta in pairs]
    keys = [(id(p), x.pressure_key) for (p, _), x in zip(pairs, parts, strict=True)]
    first = {key: i for i, key in reversed(list(enumerate(keys)))}
    jobs = [(pairs[i][0], parts[i]) for i in first.values()]
    found = in_batches(
        _simulate_pressures,
        jobs,
        [structure_of(part.extended) for _, part in jobs],
        [p.grid.steps for p, _ in jobs],
        BATCH,
    )
    of_key = dict(zip(first, found, strict=True))
    return [of_key[key] for key in keys]


def _simulate_pressures(jobs: Sequence[tuple[TrialPlan, PartialModel]]) -> list[PressureHistory]:
    extended, theta = stacked([x.extended for _, x in jobs]), stacked([x.theta for _, x in jobs])
    begin = stacked([start_chambers(x.model) for _, x in jobs])
    block = BLOCK * jobs[0][0].scheme.stages

    def history(times: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        longest = max(len(t) for t in times)
        t = np.stack([extended_grid(x, longest) for x in times])
        state, p, acting = begin, [begin.p[:, None]], [begin.acting[:, None]]
        for done in range(0, longest - 1, block):
            there = _chambers((), extended, theta, state, t[:, done : done + block + 1])
            p.append(np.asarray(there.p))
            acting.append(np.asarray(there.acting))
            state = jax.tree.map(lambda x: x[:, -1], there)
        return np.concatenate(p, axis=1), np.concatenate(acting, axis=1)

    at_stages = [stage_times(p) for p, _ in jobs]
    at_samples = [sample_grid(p) for p, _ in jobs]
    (p, acting), (sampled_p, _) = history(at_stages), history(at_samples)
    return [
        PressureHistory(p[i, : len(t)], acting[i, : len(t)], sampled_p[i, : len(at_samples[i])])
        for i, t in enumerate(at_stages)
    ]


class BodySeries(NamedTuple):
    """Ideal sensors' readings of the robot, before the effects of sensors."""

    series: np.ndarray
    """Readings (steps + 1, channels) at the start and at the ends of whole blocks of steps."""
    failed_at: float
    """Time [s] of the first step that failed; infinite if all steps converged."""


class _BodyJob(NamedTuple):
    plan: TrialPlan
    part: PartialModel
    history: PressureHistory


def body_readings(
    pairs: Sequence[tuple[TrialPlan, np.ndarray]],
    histories: Sequence[PressureHistory],
    part_of: PartOf = acting_part,
) -> list[BodySeries]:
    """Returns the ideal sensors' readings of each pair, whose pressures are `histories`."""
    jobs = [
        _BodyJob(p, part_of(p.extended, Part.BODY, theta), history)
        for (p, theta), history in zip(pairs, histories, strict=True)
    ]
    return in_batches(
        _simulate_bodies,
        jobs,
        [structure_of((x.part.extended, x.plan.numerics, x.plan.scheme)) for x in jobs],
        [x.plan.grid.steps for x in jobs],
        1 if len(jobs) == 1 else batch_size(jobs[0].plan),
    )


def batch_size(p: TrialPlan) -> int:
    """Returns the number of trials in one batch of the simulation of the robot."""
    return 1 if p.numerics.tail_cells + p.numerics.body_cells >= SINGLE_CELLS else BATCH


def _simulate_bodies(jobs: Sequence[_BodyJob]) -> list[BodySeries]:
    first, last = jobs[0].plan, max(x.plan.grid.steps for x in jobs)
    extended, theta = (stacked(list(x)) for x in zip(*(x.part[:2] for x in jobs), strict=True))
    h = np.array([x.plan.grid.h for x in jobs])

    def advance(done: int, carry: Carry):
        chambers = stacked([x.history.block(done, first.scheme.stages) for x in jobs])
        static = (first.numerics, first.scheme)
        return _advance(static, extended, theta, carry, chambers, h, h * done)

    begin = _begin((first.numerics,), extended, theta)
    parts, carry = run_chunks(advance, begin, last, BLOCK)
    channels = first.extended.channels
    start = with_pressures(channels, np.stack([x.history.p[:1] for x in jobs]))
    series = np.concatenate([start, *parts], axis=1)
    extrapolate_start(channels, series)
    failed_at = np.asarray(carry.failed_at)
    return [BodySeries(series[i], float(failed_at[i])) for i in range(len(jobs))]


def _sensor_readings(
    pairs: Sequence[tuple[TrialPlan, np.ndarray]],
    histories: Sequence[PressureHistory],
    bodies: Sequence[BodySeries],
    part_of: PartOf,
) -> list[np.ndarray]:
    """Returns the readings (channels, samples) of each pair, with the effects of the sensors."""
    jobs = []
    for (p, theta), history, body in zip(pairs, histories, bodies, strict=True):
        part = part_of(p.extended, Part.SENSORS, theta)
        jobs.append((part, p.grid.h * np.arange(len(body.series)), body.series))
        jobs.append((part, sample_grid(p), with_pressures(p.extended.channels, history.sampled)))
    read, readings = iter(_recorded_each(jobs)), []
    for (p, _), body in zip(pairs, bodies, strict=True):
        series = np.array(next(read))
        t = p.grid.h * np.arange(series.shape[1])
        series[:, t >= body.failed_at - 0.5 * p.grid.h] = np.nan
        readings.append(sampled(p, series, next(read)))
    return readings


def _recorded_each(jobs: Sequence[tuple[PartialModel, np.ndarray, np.ndarray]]) -> list[np.ndarray]:
    """Returns the readings (channels, n) of each (sensors, times (n,), ideal series (n, channels)).

    Without effects, the sensors are ideal.
    """
    found = {i: series.T for i, (part, _, series) in enumerate(jobs) if not part.has_effects}
    rest = [i for i in range(len(jobs)) if i not in found]
    long = [(jobs[i][0], *padded(*jobs[i][1:])) for i in rest]
    read = in_batches(
        _read_batch,
        long,
        [structure_of((part.extended, t)) for part, t, _ in long],
        [len(t) for _, t, _ in long],
        BATCH,
    )
    for i, x in zip(rest, read, strict=True):
        found[i] = x[:, : len(jobs[i][1])]
    return [found[i] for i in range(len(jobs))]


def _read_batch(jobs: Sequence[tuple[PartialModel, np.ndarray, np.ndarray]]) -> list[np.ndarray]:
    parts, t, series = (list(x) for x in zip(*jobs, strict=True))
    extended, theta = stacked([x.extended for x in parts]), stacked([x.theta for x in parts])
    return list(np.asarray(_read((), extended, theta, np.stack(t), np.stack(series))))
