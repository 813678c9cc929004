"""One trial of an experiment, from its drive to what its sensors would read."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slider_jax import observables as obs
from slider_jax.actuation import Recorded
from slider_jax.beam.parameters import Numerics, grid_of
from slider_jax.beam.state import node_positions, to_plane
from slider_jax.channels import CHANNELS, TIME, Channel, recorded_series
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import Carry, Snapshot, at_rest
from slider_jax.dynamics.time_schemes import Scheme
from slider_jax.effects import total_force
from slider_jax.errors import SolverError
from slider_jax.experiment.load import Experiment, sample_times, to_model, to_numerics
from slider_jax.experiment.playback import LONGEST_STEP, PlayedDrive, played
from slider_jax.experiment.schema import Trial
from slider_jax.simulation.sampling import edge_steps, half_period_steps, nearest_steps, sample

CHUNK = 250
"""Steps per call of the compiled program: one program serves trials of every length."""


@dataclass(frozen=True)
class SavedSeries:
    """What is kept of every step: each channel's true reading, and for pictures the shape.

    With `shape`, in the plane: `midline` (2, nodes) [m] relative to the head, `moment` (nodes,)
    [N m], and `force` (2, cells), the effects' force per length on the body [N/m].
    """

    channels: tuple[Channel, ...]
    shape: bool = False

    def __call__(self, x: Snapshot) -> dict[str, Array]:
        saved = {channel.name: channel.observe(x) for channel in self.channels}
        if not self.shape:
            return saved
        section = x.section()
        F_tau, F_n = total_force(x.stage.effects, section)
        return saved | {
            "midline": obs.midline(x) - x.head[:, None],
            "moment": x.y[2],
            "force": jnp.stack(to_plane(F_tau, F_n, section.phi)),
        }

    def start(self, model: Model, midline: np.ndarray) -> dict[str, np.ndarray]:
        """The same of the initial state: straight, no force yet. `midline` (2, nodes) [m]."""
        values = {x.name: np.asarray(x.start(midline), float) for x in self.channels}
        values["p_front"] = np.asarray(model.drive.start_front)
        values["p_rear"] = np.asarray(model.drive.start_rear)
        if self.shape:
            values["midline"] = midline
            values["moment"] = np.zeros(midline.shape[1])
            values["force"] = np.zeros((2, midline.shape[1] - 1))
        return values


@dataclass(frozen=True)
class StepGrid:
    """A trial's time grid: `steps` of `h` [s]; `half_period` of them to half a stride, if any."""

    h: float
    steps: int
    half_period: int | None = None
    phase: float = 0.0
    played: np.ndarray | None = None
    """Edges of a square wave as it was played [s]."""

    @property
    def edges(self) -> np.ndarray:
        """Step indices between which the drive is smooth."""
        if self.played is not None:
            return nearest_steps(self.steps, self.h, self.played)
        if self.half_period is None:
            return np.array([0, self.steps])
        return edge_steps(self.steps, self.half_period, self.phase)


def clock(
    experiment: Experiment, trial: Trial, model: Model, was: PlayedDrive | None = None
) -> StepGrid:
    """Steps locked to the stride, or to the samples of a recorded drive."""
    longest = experiment.numerics.step
    if was is not None:
        longest = min(longest, LONGEST_STEP)
    if isinstance(model.drive.front, Recorded):
        times = np.asarray(model.drive.front.times)
        spacing = (times[-1] - times[0]) / (len(times) - 1)
        h = spacing / np.ceil(spacing / longest * (1.0 - 1e-9))
        return StepGrid(h, _whole(trial.duration / h))
    if trial.frequency is None:
        return StepGrid(longest, _whole(trial.duration / longest))
    half = half_period_steps(trial.frequency, longest, trial.phase)
    h = 0.5 / (trial.frequency * half)
    edges = None if was is None else was.edges
    return StepGrid(h, _whole(trial.duration / h), half, trial.phase, edges)


def _whole(steps: float) -> int:
    return max(4, int(np.ceil(steps * (1.0 - 1e-9))))


@eqx.filter_jit
def _begin(model: Model, numerics: Numerics) -> tuple[Carry, jax.Array]:
    """At rest relative to the clamp, and the midline (2, nodes) [m] from the head."""
    carry, grid = at_rest(model, numerics), grid_of(model.body, numerics)
    return carry, node_positions(
        carry.memory.motion[2], carry.memory.strain, carry.memory.head, grid
    )


@eqx.filter_jit
def _advance(
    model: Model,
    h: jax.Array,
    t0: jax.Array,
    begin: Carry,
    save: Callable[[Snapshot], Any],
    numerics: Numerics,
    scheme: Scheme,
    steps: int,
):
    """`steps` more steps of `h` [s] from `t0` [s]: what was saved, and what carries on."""
    times = TimeGrid(h, steps, t0)
    run = rollout(model, times, save, numerics, scheme, begin=begin, checkpoint=False)
    return run.saved, run.final


@dataclass(frozen=True)
class TrialRun:
    """A simulated trial. Times and series on the steps start with the initial state."""

    trial: Trial
    clock: StepGrid
    t: np.ndarray
    """(steps + 1,) [s]."""
    series: dict[str, np.ndarray]
    """What `SavedSeries` keeps, each (steps + 1, ...); channels as the sensors record them."""
    columns: dict[str, np.ndarray]
    """The CSV columns, (samples,) each: t_s and every channel's, at the trial's sample times."""
    factorisations: int
    """Of the Jacobian, in all."""


def simulate(
    experiment: Experiment,
    trial: Trial | int = 0,
    *,
    shape: bool = False,
    progress: Callable[[int, int], None] | None = None,
    chunk: int = CHUNK,
    as_meant: bool = False,
) -> TrialRun:
    """Simulate one trial and sample it at the trial's own times.

    Where it is known how the drive was played, it is driven so (`slider_jax.experiment.playback`),
    unless
    `as_meant`. The robot starts straight and at rest relative to the clamp, no force on it. With
    `shape`, midlines, moments and forces are kept too. `progress(steps done, steps in all)` is
    called now and then. Trials of one waveform and mesh share one compiled program. Raises
    `SolverError` naming trial, time and step if a step does not converge, `InputError` if the
    trial's files cannot be used.
    """
    if isinstance(trial, int):
        trial = experiment.trials[trial]
    model, at = to_model(experiment, trial), sample_times(experiment, trial)
    was = None if as_meant else played(experiment, trial)
    if was is not None:
        model = replace(model, drive=was.drive)
    numerics, scheme = to_numerics(experiment)
    grid = clock(experiment, trial, model, was)
    channels = tuple(CHANNELS.values())
    save = SavedSeries(channels, shape)
    carry, line = _begin(model, numerics)
    initial = save.start(model, np.asarray(line))
    chunks = []
    for done in range(0, grid.steps, chunk):
        t0 = jnp.asarray(grid.h * done)
        saved, carry = _advance(
            model, jnp.asarray(grid.h), t0, carry, save, numerics, scheme, chunk
        )
        chunks.append(jax.tree.map(np.asarray, saved))
        if float(carry.failed_at) < grid.h * (grid.steps + 0.5):
            raise _failure(trial, grid, float(carry.failed_at))
        if progress is not None:
            progress(min(done + chunk, grid.steps), grid.steps)
    series = {
        name: np.concatenate([initial[name][None], *(c[name] for c in chunks)])[: grid.steps + 1]
        for name in chunks[0]
    }
    t = grid.h * np.arange(grid.steps + 1)
    true = {x.name: jnp.asarray(series[x.name]) for x in channels}
    read = recorded_series(model.effects, jnp.asarray(t), true)
    series |= {name: np.asarray(values) for name, values in read.items()}
    bad = ~np.isfinite(series["recoil"])
    if bad.any():
        raise _failure(trial, grid, float(t[np.argmax(bad)]))
    columns = {TIME: at} | {x.column: sample(t, series[x.name], at, grid.edges) for x in channels}
    return TrialRun(trial, grid, t, series, columns, int(carry.factorisations))


def _failure(trial: Trial, grid: StepGrid, t: float) -> SolverError:
    return SolverError(
        f"{trial.file}: the step to t = {t:.6g} s (length {grid.h:.3g} s) did not converge; try a "
        f"shorter one (--step {0.5 * grid.h:.2g}), and check amplitude, K_Q and stiffness: the "
        "chambers may bend the body further than it can go"
    )
