"""Prepares a trial for simulation: model, steps, sample times, played drive, measured data."""

from dataclasses import dataclass, replace

import numpy as np

from slider_jax.actuation import Recorded
from slider_jax.beam.parameters import Numerics
from slider_jax.channels import TIME, ChannelSet
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.time_schemes import Scheme
from slider_jax.experiment.drive import delays_of
from slider_jax.experiment.load import Experiment, read_measured, to_model, to_numerics
from slider_jax.experiment.playback import LONGEST_STEP, PlayedDrive, read_played
from slider_jax.experiment.schema import Trial


@dataclass(frozen=True)
class StepGrid:
    """A trial's time grid of `steps` equal steps."""

    h: float
    """Time step [s]."""
    steps: int
    half_period: int | None = None
    """Number of steps per half stride; None for a recorded drive."""
    delays: tuple[float, ...] = (0.0,)
    """Delays of the chambers' set pressures, as fractions of a stride."""
    played: np.ndarray | None = None
    """Times [s] of the pressure steps of a played square wave; None for other drives."""

    @property
    def stride(self) -> int:
        """Number of steps per stride, or per second if `half_period` is None."""
        return 2 * self.half_period if self.half_period else round(1.0 / self.h)

    @property
    def times(self) -> np.ndarray:
        """Times (steps + 1,) [s]: 0 and the ends of all steps."""
        return self.h * np.arange(self.steps + 1)

    @property
    def edges(self) -> np.ndarray:
        """Indices in `times` nearest to the drive's pressure steps, including 0 and `steps`."""
        if self.played is not None:
            near = np.round(np.asarray(self.played) / self.h).astype(int)
            inner = near[(near > 0) & (near < self.steps)]
            return np.unique(np.concatenate([inner, [0, self.steps]]))
        if self.half_period is None:
            return np.array([0, self.steps])
        return edge_steps(self.steps, self.half_period, self.delays)


def step_grid(
    trial: Trial,
    longest: float,
    end: float,
    spacing: float | None = None,
    played: PlayedDrive | None = None,
    delays: tuple[float, ...] = (0.0,),
) -> StepGrid:
    """Returns a grid up to `end` [s] with steps of at most `longest` [s].

    If the `spacing` [s] of a recorded drive is given, the spacing is a multiple of the step.
    Otherwise, if the trial has a frequency, half a stride is a multiple of the step. `delays` are
    the delays of the chambers' set pressures, as fractions of a stride.
    """
    half, edges = None, None if played is None else played.edges
    if spacing is not None:
        h = divided_step(spacing, longest)
    elif trial.frequency is None:
        h = longest
    else:
        half = half_period_steps(trial.frequency, longest, delays)
        h = 0.5 / (trial.frequency * half)
    steps = max(4, int(np.ceil(end / h * (1.0 - 1e-9))))
    return StepGrid(h, steps, half, delays, edges)


def divided_step(spacing: float, longest: float) -> float:
    """Returns the largest step [s] that divides `spacing` [s] and is at most `longest` [s]."""
    return spacing / np.ceil(spacing / longest * (1.0 - 1e-9))


@dataclass(frozen=True)
class PreparedTrial:
    """A trial with its model, its time grid and the content of its files."""

    trial: Trial
    model: Model
    """The trial's model, with the played drive if `played` is not None."""
    numerics: Numerics
    scheme: Scheme
    grid: StepGrid
    lead: float
    """Time [s] that the simulation begins before the trial's time 0."""
    sample_times: np.ndarray
    """Sample times (n,) [s] since the simulation's begin."""
    played: PlayedDrive | None
    """The drive that the valves followed; None if the model has the experiment file's drive."""
    measured: dict[str, np.ndarray] | None
    """Columns of the trial's measured file, or None if this file does not exist."""
    channels: ChannelSet


def prepare(
    experiment: Experiment,
    trial: Trial | int = 0,
    *,
    sample_times: np.ndarray | None = None,
    declared_drive: bool = False,
) -> PreparedTrial:
    """Reads a trial's files, builds the model, and chooses the time steps according to [numerics].

    If `sample_times` (n,) [s] are given, the trial's measured file is not read. Otherwise, the
    sample times come from the measured file, or from sensors.sample_rate if this file does not
    exist. If `declared_drive` is true, the model has the drive of the experiment file, not the
    played drive. Raises `InputError` if a file is invalid.
    """
    if isinstance(trial, int):
        trial = experiment.trials[trial]
    columns = None
    if sample_times is None:
        columns, rate = read_measured(experiment, trial), experiment.sensors.sample_rate
        if columns is None:
            count = int(np.floor(trial.duration * rate + 1e-9)) + 1
            sample_times = np.arange(count) / rate
        else:
            sample_times = columns[TIME]
    model = to_model(experiment, trial)
    played = None if declared_drive else read_played(experiment, trial)
    longest, spacing = experiment.numerics.step, None
    if played is not None:
        model, longest = replace(model, drive=played.drive), min(longest, LONGEST_STEP)
    recorded = [np.asarray(x.times) for x in model.drive.waves if isinstance(x, Recorded)]
    if recorded:
        times = recorded[0]
        spacing = (times[-1] - times[0]) / (len(times) - 1)
    lead = trial.lead
    delays = delays_of(trial, len(experiment.chambers))
    grid = step_grid(trial, longest, lead + trial.duration, spacing, played, delays)
    numerics, scheme = to_numerics(experiment)
    return PreparedTrial(
        trial=trial,
        model=model,
        numerics=numerics,
        scheme=scheme,
        grid=grid,
        lead=lead,
        sample_times=lead + sample_times,
        played=played,
        measured=columns,
        channels=experiment.channels,
    )


def half_period_steps(frequency: float, longest: float, delays: tuple[float, ...] = (0.0,)) -> int:
    """Returns the number of steps of at most `longest` [s] in a half period of `frequency` [Hz].

    A set pressure without delay therefore jumps at ends of steps. The number is increased by up to
    a quarter if then the set pressures with the `delays` [periods] also jump at ends of steps.
    """
    least = max(2, int(np.ceil(0.5 / (frequency * longest) * (1.0 - 1e-12))))
    for steps in range(least, least + least // 4 + 1):
        if all(abs(2 * steps * x - round(2 * steps * x)) < 1e-6 for x in delays):
            return steps
    return least


def edge_steps(steps: int, half_period: int, delays: tuple[float, ...] = (0.0,)) -> np.ndarray:
    """Returns the indices of the steps at which a set pressure jumps, and 0 and `steps`."""
    first = [round(2 * half_period * x) % half_period for x in delays]
    jumps = [np.arange(x, steps, half_period) for x in first]
    return np.unique(np.concatenate([*jumps, [0, steps]]))


def sample_series(
    t: np.ndarray, values: np.ndarray, at: np.ndarray, edges: np.ndarray
) -> np.ndarray:
    """Interpolates `values` (n, ...), given at evenly spaced times `t` (n,), to the times `at`.

    Each cubic polynomial uses the four nearest times between two neighbouring `edges` (indices of
    t), and does not cross an edge. Between edges with fewer than four times, its degree is lower.
    """
    h = (t[-1] - t[0]) / (len(t) - 1)
    place = np.clip((at - t[0]) / h, 0.0, len(t) - 1.0)
    cell = np.minimum(place.astype(int), len(t) - 2)
    part = np.clip(np.searchsorted(edges, cell, side="right") - 1, 0, len(edges) - 2)
    low, high = edges[part], edges[part + 1]
    first = np.maximum(np.minimum(cell - 1, high - 3), low)
    count = np.minimum(high - first + 1, 4)
    result = np.zeros((len(at), *values.shape[1:]))
    for i in range(4):
        weight = np.where(i < count, 1.0, 0.0)
        for j in range(4):
            if i != j:
                factor = (place - first - j) / (i - j)
                weight = weight * np.where(j < count, factor, 1.0)
        node = np.minimum(first + i, len(t) - 1)
        result += weight.reshape(-1, *[1] * (values.ndim - 1)) * values[node]
    return result
