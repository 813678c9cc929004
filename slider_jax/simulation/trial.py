"""Simulates one trial of an experiment, from its drive to the sensors' readings."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slider_jax import observables as obs
from slider_jax.beam.parameters import Numerics, grid_of
from slider_jax.beam.spatial import about_b
from slider_jax.beam.state import node_positions
from slider_jax.channels import TIME, ChannelSet
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.rollout import TimeGrid, continued
from slider_jax.dynamics.step import Carry, Snapshot, at_rest
from slider_jax.dynamics.time_schemes import Scheme
from slider_jax.errors import SolverError
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.prepare import PreparedTrial, StepGrid, prepare, sample_series
from slider_jax.experiment.schema import Trial
from slider_jax.programs import compiled_once
from slider_jax.spatial.step import (
    SpatialCarry,
    SpatialSnapshot,
    at_rest_in_space,
    spatial_rollout,
    straight_line,
)
from slider_jax.water import GriddedField

State = TypeVar("State")
CHUNK = 250
"""Number of time steps per call of the compiled program, which trials of all lengths share."""


@dataclass(frozen=True)
class SavedSeries:
    """Selects the series that are saved at every step: the true reading of each channel.

    If `shape` is true, four series are added: `midline` (2, nodes) [m] relative to the head,
    `moment` (nodes,) [N m] about b, `force` (2, cells), the effects' force per length [N/m], and
    `frame` (4, nodes), the quaternions of the sections' frames. If `path` is true, two series are
    added: `head` (2,) [m], the position of the head in the tank, and `ahead` (2,) [m], the vector
    from the tail to the head.
    Vectors of a robot in three dimensions have three components.
    """

    channels: ChannelSet
    shape: bool = False
    path: bool = False

    def __call__(self, x: obs.AnySnapshot) -> dict[str, Array]:
        saved = self.channels.observe(x)
        if self.path:
            saved |= {"head": x.head, "ahead": x.head - x.positions()[:, 0]}
        if not self.shape:
            return saved
        return saved | {
            "midline": x.positions() - x.head[:, None],
            "moment": x.moments(),
            "force": x.force_density(),
            "frame": x.frame
            if isinstance(x, SpatialSnapshot)
            else jnp.stack(about_b(x.headings())),
        }

    def start(
        self, model: Model, midline: np.ndarray, frame: Array | None = None
    ) -> dict[str, np.ndarray]:
        """Returns the series' initial values for `midline` [m] and `frame`, without forces."""
        values = {
            name: np.asarray(x.start(midline) if x.start else 0.0, float)
            for name, x in self.channels.items()
        }
        pressures = self.channels.pressures
        start = np.broadcast_to(model.drive.start, len(pressures))
        values |= dict(zip(pressures, start, strict=True))
        if self.path:
            values |= {"head": 0.0 * midline[:, -1], "ahead": midline[:, -1] - midline[:, 0]}
        if self.shape:
            values["midline"], values["frame"] = midline, np.asarray(frame)
            values["moment"] = np.zeros(midline.shape[1])
            values["force"] = np.zeros_like(midline[:, 1:])
        return values


@compiled_once
def _begin(model: Model, numerics: Numerics) -> tuple[Carry, Array, Array]:
    """Returns the state at rest, its midline (2, nodes) [m] relative to the head, and its frames.

    The frames are quaternions (4, nodes).
    """
    carry = at_rest(model, numerics)
    phi, strain, head = carry.memory.motion[2], carry.memory.strain, carry.memory.head
    line = node_positions(phi, strain, head, grid_of(model.body, numerics))
    return carry, line, jnp.stack(about_b(phi))


@compiled_once
def advance_chunk(
    model: Model,
    h: jax.Array,
    t0: jax.Array,
    begin: Carry,
    save: Callable[[Snapshot], Any],
    numerics: Numerics,
    scheme: Scheme,
    steps: int,
) -> tuple[Any, Carry]:
    """Runs `steps` steps of `h` [s] from `t0` [s]. Returns the saved series and the final state."""
    times = TimeGrid(h, steps, t0)
    run = continued(begin, model, times, save, numerics, scheme)
    return run.saved, run.final


@compiled_once
def _begin_in_space(model: Model, numerics: Numerics) -> tuple[SpatialCarry, Array, Array]:
    """Does the same as `_begin` in three dimensions."""
    carry = at_rest_in_space(model, numerics)
    return carry, straight_line(carry, grid_of(model.body, numerics).s), carry.frames[-1]


@compiled_once
def _advance_in_space(
    model: Model,
    h: jax.Array,
    t0: jax.Array,
    begin: SpatialCarry,
    save: Callable[[SpatialSnapshot], Any],
    numerics: Numerics,
    scheme: Scheme,
    steps: int,
) -> tuple[Any, SpatialCarry]:
    """Does the same as `advance_chunk` in three dimensions."""
    times = TimeGrid(h, steps, t0)
    run = spatial_rollout(model, times, save, numerics, scheme, begin=begin, checkpoint=False)
    return run.saved, run.final


def run_chunks(
    advance: Callable[[int, State], tuple[Any, State]],
    carry: State,
    steps: int,
    chunk: int,
    after: Callable[[int, Any, State], None] = lambda done, saved, carry: None,
) -> tuple[list[Any], State]:
    """Runs `steps` steps from the state `carry`, rounded up to whole chunks of `chunk` steps.

    Returns each chunk's saved series, and the final state. `advance(done, carry)` runs the chunk
    after `done` steps; it returns the chunk's saved series and the new state. `after(done, saved,
    carry)` is called after each chunk; `done` is the number of completed steps, at most `steps`.
    """
    parts = []
    for done in range(0, steps, chunk):
        saved, carry = advance(done, carry)
        parts.append(saved)
        after(min(done + chunk, steps), saved, carry)
    return parts, carry


@dataclass(frozen=True)
class TrialRun:
    """A simulated trial. All series start at the trial's time 0."""

    prepared: PreparedTrial
    series: dict[str, np.ndarray]
    """Series of `SavedSeries` (steps + 1, ...). Channels contain the sensors' recorded readings."""
    columns: dict[str, np.ndarray]
    """CSV columns (samples,): t_s and every channel at the trial's sample times."""
    factorisations: int
    """Number of factorisations of the Jacobian in the simulation."""

    @property
    def trial(self) -> Trial:
        return self.prepared.trial

    @property
    def grid(self) -> StepGrid:
        """The time grid from the trial's time 0."""
        whole = self.prepared.grid
        return replace(whole, steps=whole.steps - round(self.prepared.lead / whole.h))

    @property
    def t(self) -> np.ndarray:
        """Times of the series (steps + 1,) [s]."""
        return self.grid.times


def simulate_trial(
    experiment: Experiment, trial: Trial | int = 0, *, declared_drive: bool = False, **options: Any
) -> TrialRun:
    """Prepares and simulates one trial, with the `options` of `simulate_prepared`."""
    return simulate_prepared(prepare(experiment, trial, declared_drive=declared_drive), **options)


def simulate_prepared(
    prepared: PreparedTrial,
    *,
    shape: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
    chunk: int = CHUNK,
) -> TrialRun:
    """Simulates a prepared trial and interpolates the series at the sample times.

    The robot starts straight and at rest relative to the clamp, without forces. With `shape`, the
    result contains midlines, moments, forces and frames. `progress(steps done, total)` is called
    after each chunk. Trials with the same waveform and mesh share one compiled program. Raises
    `SolverError` with the trial, time and step if a step does not converge.
    """
    model, numerics, grid = prepared.model, prepared.numerics, prepared.grid
    save = SavedSeries(prepared.channels, shape, path=prepared.trial.support == "free")
    spatial = model.space is not None
    start, line, frame = (_begin_in_space if spatial else _begin)(model, numerics)
    run_chunk: Callable = _advance_in_space if spatial else advance_chunk
    h = jnp.asarray(grid.h)

    def advance(done: int, carry: Any):
        t0 = jnp.asarray(grid.h * done)
        saved, carry = run_chunk(model, h, t0, carry, save, numerics, prepared.scheme, chunk)
        return jax.tree.map(np.asarray, saved), carry

    def after(done: int, saved, carry: Any) -> None:
        if float(carry.failed_at) < grid.h * (grid.steps + 0.5):
            raise _failure(prepared, float(carry.failed_at))
        progress(done, grid.steps)

    parts, carry = run_chunks(advance, start, grid.steps, chunk, after)
    series = {
        name: np.concatenate([first[None], *(part[name] for part in parts)])[: grid.steps + 1]
        for name, first in save.start(model, np.asarray(line), frame).items()
    }
    for name in prepared.channels.without_start:
        series[name][0] = 2.0 * series[name][1] - series[name][2]
    t, at = grid.times, prepared.sample_times
    true = {name: jnp.asarray(series[name]) for name in prepared.channels}
    read = prepared.channels.recorded(model.effects, jnp.asarray(t), true)
    series |= {name: np.asarray(values) for name, values in read.items()}
    bad = ~np.isfinite(series["recoil"])
    if bad.any():
        raise _failure(prepared, float(t[np.argmax(bad)]))
    edges = grid.edges
    lead = round(prepared.lead / grid.h)
    columns = {
        x.column: sample_series(t, series[name], at, edges) for name, x in prepared.channels.items()
    }
    series = {name: values[lead:] for name, values in series.items()}
    times = {TIME: at - prepared.lead}
    return TrialRun(prepared, series, times | columns, int(carry.factorisations))


def _failure(prepared: PreparedTrial, t: float) -> SolverError:
    h = prepared.grid.h
    if isinstance(prepared.model.water, GriddedField):
        return SolverError(
            f"{prepared.trial.file}: the step to t = {t:.6g} s did not converge; give a larger "
            "field if the robot left the grid of the water; otherwise use a shorter step "
            f"(--step {0.5 * h:.2g})"
        )
    return SolverError(
        f"{prepared.trial.file}: the step to t = {t:.6g} s (length {h:.3g} s) did not converge; "
        f"use a shorter step (--step {0.5 * h:.2g}), and check amplitude, K_Q and stiffness: the "
        "bending moment may be too large for the body"
    )
