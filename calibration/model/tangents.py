"""Computes tangents of a trial's readings: derivatives with respect to parameters, or states.

As in `predict`, the pressures, the robot and the sensors have separate programs.
"""

from collections.abc import Callable
from functools import partial

import jax
import numpy as np

from calibration.model.compiled import (
    DIRECTIONS,
    by_directions,
    rows_per_call,
    slices,
    with_tangents,
)
from calibration.model.extended import (
    ExtendedModel,
    Part,
    PartialModel,
    acting_part,
    changed_part,
    is_at_null,
    model_parameters,
)
from calibration.model.plan import (
    BLOCK,
    TrialPlan,
    at_samples,
    extrapolate_start,
    first_block,
    padded,
    stage_times,
    with_pressures,
)
from calibration.model.predict import (
    PressureHistory,
    advance_block,
    advance_chambers,
    begin_at_rest,
    body_readings,
    pressure_histories,
    read_series,
)
from slider_jax.beam.parameters import Numerics
from slider_jax.dynamics.pressures import Chambers, start_chambers
from slider_jax.dynamics.step import Carry
from slider_jax.dynamics.time_schemes import Scheme
from slider_jax.effects.library import KNOWN_EFFECTS
from slider_jax.programs import compiled_once
from slider_jax.simulation.trial import run_chunks

PartAlong = Callable[[ExtendedModel, Part, np.ndarray, np.ndarray], PartialModel]


@compiled_once
def _begin_along(extended: ExtendedModel, theta, directions, numerics: Numerics):
    return with_tangents(lambda x: begin_at_rest(extended, x, numerics), (theta,), (directions,))


@compiled_once
def _advance_along(extended: ExtendedModel, here, along, h, t0, numerics: Numerics, scheme: Scheme):
    """Returns the value of `advance_block` at `here` = (theta, carry, chambers), and tangents."""

    def function(theta, carry, chambers):
        return advance_block(extended, theta, carry, chambers, h, t0, numerics, scheme)

    return with_tangents(function, here, along)


@compiled_once
def _chambers_along(extended: ExtendedModel, theta, begin, times, d_theta, d_begin):
    def function(theta, begin):
        return advance_chambers(extended, theta, begin, times)

    return with_tangents(function, (theta, begin), (d_theta, d_begin))


@compiled_once
def _read_along(extended: ExtendedModel, theta, t, series, d_theta, d_series):
    def function(theta, series):
        return read_series(extended, theta, t, series)

    return with_tangents(function, (theta, series), (d_theta, d_series))[1]


def reading_tangents(
    p: TrialPlan, theta: np.ndarray, directions: np.ndarray, dtype: type = float
) -> np.ndarray:
    """Returns tangents (k, channels, samples) of the readings along `directions` (k, entries).

    The tangents of all channels, also of the pressures, are interpolated between time steps. The
    result has the type `dtype`. Directions of zeros need no time, and almost no memory.
    """
    at_null = is_at_null(p.extended, theta)
    pressures = _moves(p.extended, Part.PRESSURES, directions)
    moves = pressures | _moves(p.extended, Part.BODY, directions)
    found: np.ndarray = np.zeros((len(directions), len(p.extended.channels), len(p.at)), dtype)
    ideal: list[np.ndarray] = []

    def along(d: np.ndarray, part_of: PartAlong) -> np.ndarray:
        body = part_of(p.extended, Part.BODY, theta, d)
        state = _begin_along(body.extended, body.theta, d[:, body.entries], p.numerics)
        series, d_series = _ideal_tangents(p, theta, d, body, state, dtype=dtype, part_of=part_of)
        ideal[:] = [series]
        return _recorded_tangents(p, theta, d, series, d_series, dtype, part_of)

    def along_sensors(d: np.ndarray, part_of: PartAlong) -> np.ndarray:
        still = np.zeros((len(d), *ideal[0].shape), dtype)
        return _recorded_tangents(p, theta, d, ideal[0], still, dtype, part_of)

    def set_along(function: Callable, chosen: np.ndarray, rows: int) -> None:
        # If there are several calls, each contains only the effects that its directions change.
        part_of = changed_part if at_null and len(chosen) > rows else acting_part
        _set_along(found, partial(function, part_of=part_of), directions, chosen, rows)

    # A call with directions of one kind omits effects of the other kind. With equal numbers of
    # rows, both calls share the programs in which no effect differs.
    kinds = [pressures, moves & ~pressures] if moves.sum() > DIRECTIONS else [moves]
    kinds = [x for x in kinds if x.any()]
    rows = max((rows_per_call(int(x.sum())) for x in kinds), default=0)
    for kind in kinds:
        set_along(along, np.flatnonzero(kind), rows)
    sensors = np.flatnonzero(~moves & directions.any(axis=1))
    if sensors.size:
        if not ideal:
            history = pressure_histories([(p, theta)])
            ideal[:] = [body_readings([(p, theta)], history)[0].series]
        set_along(along_sensors, sensors, rows_per_call(len(sensors)))
    return found


def _set_along(
    found: np.ndarray,
    function: Callable[[np.ndarray], np.ndarray],
    directions: np.ndarray,
    chosen: np.ndarray,
    rows: int,
) -> None:
    """Sets the `chosen` rows of `found` to `function` of the `directions`.

    Series of zeros are not written: the memory of an array of zeros is empty until it is written.
    """
    for here, tangents in by_directions(function, directions[chosen], rows):
        for channel in range(tangents.shape[1]):
            moving = np.flatnonzero(tangents[:, channel].any(axis=1))
            found[chosen[here][moving], channel] = tangents[moving, channel]


def compile_tangents(p: TrialPlan, theta: np.ndarray, directions: np.ndarray) -> None:
    """Compiles the programs of `reading_tangents` for `directions` (k, entries)."""
    reading_tangents(first_block(p), theta, directions)


def initial_state_tangents(
    p: TrialPlan, theta: np.ndarray, d_carry: Carry, initial: np.ndarray
) -> np.ndarray:
    """Returns tangents (k, channels, samples) with respect to initial states.

    `d_carry` are the tangents of the initial state of the model `acting_part`; their first axis is
    the direction. `initial` (k, channels) are the tangents of the readings at t = 0. Tangents of
    pressures are 0.
    """
    none = np.zeros((len(initial), len(theta)))
    body = acting_part(p.extended, Part.BODY, theta)
    carry, _ = _begin_along(body.extended, body.theta, none[:, body.entries], p.numerics)
    series, d_series = _ideal_tangents(p, theta, none, body, (carry, d_carry), initial)
    return _recorded_tangents(p, theta, none, series, d_series)


def _moves(extended: ExtendedModel, part: Part, directions: np.ndarray) -> np.ndarray:
    """Returns for each of the `directions` (k, entries) whether it changes this part of a model."""
    parts = [
        Part.of_kind(KNOWN_EFFECTS[x.effect])
        if x.effect
        else (Part.PRESSURES if x.name == "k" else Part.BODY)
        for x in model_parameters(extended.effects)
    ]
    own = [x is part for x in parts]
    return np.any(directions[:, own] != 0.0, axis=1)


def _ideal_tangents(
    p: TrialPlan,
    theta: np.ndarray,
    d_theta: np.ndarray,
    body: PartialModel,
    state: tuple[Carry, Carry],
    initial: np.ndarray | None = None,
    dtype: type = float,
    part_of: PartAlong = acting_part,
) -> tuple[np.ndarray, np.ndarray]:
    """Returns ideal sensors' readings (n, channels) at the steps, and tangents (k, n, channels).

    `state` is the initial state, and its tangents. The tangents of the readings have the type
    `dtype`.
    """
    h, times, block = np.asarray(p.grid.h), stage_times(p), BLOCK * p.scheme.stages
    d_body = d_theta[:, body.entries]
    start = with_pressures(p.extended.channels, np.asarray(state[0].chambers.p)[None])
    count = 1 + -(-p.grid.steps // BLOCK) * BLOCK
    series = np.zeros((count, start.shape[-1]))
    d_series: np.ndarray = np.zeros((len(d_theta), *series.shape), dtype)
    series[:1], d_series[:, 0] = start, 0.0 if initial is None else initial
    fixed: PressureHistory | None = None
    if _moves(p.extended, Part.PRESSURES, d_theta).any():
        moving = part_of(p.extended, Part.PRESSURES, theta, d_theta)
        chambers = start_chambers(moving.model)
        pressures = chambers, jax.tree.map(lambda x: np.zeros((len(d_theta), *x.shape)), chambers)
    else:
        (fixed,) = pressure_histories([(p, theta)])
        pressures = None

    def next_chambers(done: int, pressures):
        if fixed is not None:
            there = fixed.block(done, p.scheme.stages)
            return (there, jax.tree.map(lambda x: np.zeros((len(d_theta), *x.shape)), there)), None
        begin = done * p.scheme.stages
        there, d_there = _chambers_along(
            moving.extended, moving.theta, pressures[0], times[begin : begin + block + 1],
            d_theta[:, moving.entries], pressures[1],
        )  # fmt: skip
        last = jax.tree.map(lambda x: x[-1], there), jax.tree.map(lambda x: x[:, -1], d_there)
        return (Chambers(there.p, there.acting), Chambers(d_there.p, d_there.acting)), last

    def advance(done: int, state):
        (carry, d_carry), pressures = state
        (there, d_there), pressures = next_chambers(done, pressures)
        (saved, carry), (d_saved, d_carry) = _advance_along(
            body.extended, (body.theta, carry, there), (d_body, d_carry, d_there),
            h, h * done, p.numerics, p.scheme,
        )  # fmt: skip
        here = slice(1 + done, 1 + done + BLOCK)
        series[here], d_series[:, here] = saved, d_saved
        return None, ((carry, d_carry), pressures)

    run_chunks(advance, (state, pressures), p.grid.steps, BLOCK)
    extrapolate_start(p.extended.channels, series)
    if initial is None:
        extrapolate_start(p.extended.channels, d_series)
    return series, d_series


def _recorded_tangents(
    p: TrialPlan,
    theta: np.ndarray,
    d_theta: np.ndarray,
    series: np.ndarray,
    d_series: np.ndarray,
    dtype: type = float,
    part_of: PartAlong = acting_part,
) -> np.ndarray:
    """Returns tangents (k, channels, samples) of real sensors' readings from ideal sensors' ones.

    `series` (n, channels) are the readings of ideal sensors at the steps; `d_series` (k, n,
    channels) are their tangents. The result has the type `dtype`.
    """
    sensors = part_of(p.extended, Part.SENSORS, theta, d_theta)
    t, own = p.grid.h * np.arange(len(series)), d_theta[:, sensors.entries]
    at, readings = padded(t, series)
    found: np.ndarray = np.zeros((len(d_theta), len(p.extended.channels), len(p.at)), dtype)
    for rows in slices(len(d_theta), readings.size, DIRECTIONS):
        if sensors.has_effects:
            _, along = padded(t, d_series[rows].astype(float, copy=False))
            along = _read_along(sensors.extended, sensors.theta, at, readings, own[rows], along)
            found[rows] = at_samples(p, np.asarray(along))
        else:
            found[rows] = at_samples(p, np.swapaxes(d_series[rows], 1, 2))
    return found
