"""One trial, ready to simulate: its model, steps, sample times, played drive, measured data."""

from dataclasses import dataclass, replace

import numpy as np

from slider_jax.actuation import Recorded
from slider_jax.beam.parameters import Numerics
from slider_jax.channels import CHANNELS, TIME, Channel
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.time_schemes import Scheme
from slider_jax.experiment.load import Experiment, read_measured, to_model, to_numerics
from slider_jax.experiment.playback import LONGEST_STEP, PlayedDrive, read_played
from slider_jax.experiment.schema import Trial


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
    def times(self) -> np.ndarray:
        """(steps + 1,) [s], from the start on."""
        return self.h * np.arange(self.steps + 1)

    @property
    def edges(self) -> np.ndarray:
        """Step indices between which the drive is smooth."""
        if self.played is not None:
            return nearest_steps(self.steps, self.h, self.played)
        if self.half_period is None:
            return np.array([0, self.steps])
        return edge_steps(self.steps, self.half_period, self.phase)


def step_grid(
    trial: Trial,
    longest: float,
    end: float,
    spacing: float | None = None,
    was: PlayedDrive | None = None,
) -> StepGrid:
    """Steps of at most `longest` [s] that reach `end` [s].

    They divide `spacing` [s] if it is given, else half a stride if the trial has a frequency. `was`
    is the drive as it was played.
    """
    half, edges = None, None
    if spacing is not None:
        h = divided(spacing, longest)
    elif trial.frequency is None:
        h = longest
    else:
        half = half_period_steps(trial.frequency, longest, trial.phase)
        h = 0.5 / (trial.frequency * half)
    if was is not None:
        edges = was.edges
    return StepGrid(h, max(4, int(np.ceil(end / h * (1.0 - 1e-9)))), half, trial.phase, edges)


def divided(spacing: float, longest: float) -> float:
    """The largest whole fraction of `spacing` [s] that is at most `longest` [s]."""
    return spacing / np.ceil(spacing / longest * (1.0 - 1e-9))


@dataclass(frozen=True)
class PreparedTrial:
    """One trial with its files read and its model built, to be simulated as often as needed."""

    trial: Trial
    model: Model
    """With the drive as it was played, where that is known."""
    numerics: Numerics
    scheme: Scheme
    grid: StepGrid
    sample_times: np.ndarray
    """(n,) [s]"""
    played: PlayedDrive | None
    """None if no file says how the drive was played."""
    measured: dict[str, np.ndarray] | None
    """Columns of the trial's file; None without one."""
    channels: tuple[Channel, ...]


def prepare(
    experiment: Experiment,
    trial: Trial | int = 0,
    *,
    sample_times: np.ndarray | None = None,
    as_meant: bool = False,
) -> PreparedTrial:
    """Read a trial's files, build its model and lay out its steps by the experiment's [numerics].

    With `sample_times` (n,) [s], the trial's measured file is not read; else its own times are
    used, or the sensors' rate without a file. With `as_meant`, the drive is the declared one, not
    the played one. Raises `InputError` if one of the trial's files cannot be used.
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
    was = None if as_meant else read_played(experiment, trial)
    longest, spacing = experiment.numerics.step, None
    if was is not None:
        model, longest = replace(model, drive=was.drive), min(longest, LONGEST_STEP)
    if isinstance(model.drive.front, Recorded):
        times = np.asarray(model.drive.front.times)
        spacing = (times[-1] - times[0]) / (len(times) - 1)
    grid = step_grid(trial, longest, trial.duration, spacing, was)
    numerics, scheme = to_numerics(experiment)
    channels = tuple(CHANNELS.values())
    return PreparedTrial(trial, model, numerics, scheme, grid, sample_times, was, columns, channels)


def half_period_steps(frequency: float, longest: float, phase: float = 0.0) -> int:
    """Steps per half period of 1/`frequency` [Hz], none longer than `longest` [s].

    The front chamber switches at whole half periods, which are on steps by construction. Where up
    to a quarter more steps put the rear chamber's edges, `phase` of a period later, on steps too,
    they are taken.
    """
    least = max(2, int(np.ceil(0.5 / (frequency * longest) * (1.0 - 1e-12))))
    for steps in range(least, least + least // 4 + 1):
        if abs(2 * steps * phase - round(2 * steps * phase)) < 1e-6:
            return steps
    return least


def edge_steps(steps: int, half_period: int, phase: float = 0.0) -> np.ndarray:
    """Indices of steps, 0 and `steps` included, between which the drive is smooth."""
    delay = round(2 * half_period * phase) % half_period
    edges = np.concatenate(
        [np.arange(0, steps, half_period), np.arange(delay, steps, half_period), [0, steps]]
    )
    return np.unique(edges)


def nearest_steps(steps: int, h: float, times: np.ndarray) -> np.ndarray:
    """As `edge_steps`, for edges at any `times` [s]: each is put on the nearest step of `h`."""
    near = np.round(np.asarray(times) / h).astype(int)
    return np.unique(np.concatenate([near[(near > 0) & (near < steps)], [0, steps]]))


def sample(t: np.ndarray, values: np.ndarray, at: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Cubic interpolation of `values` (n, ...) at evenly spaced `t` (n,) to the times `at`.

    Each time takes the four nearest steps between two neighbouring `edges` (indices into t), so
    that no polynomial crosses an edge; a shorter stretch takes the steps that it has.
    """
    h = (t[-1] - t[0]) / (len(t) - 1)
    place = np.clip((at - t[0]) / h, 0.0, len(t) - 1.0)
    cell = np.minimum(place.astype(int), len(t) - 2)
    stretch = np.clip(np.searchsorted(edges, cell, side="right") - 1, 0, len(edges) - 2)
    low, high = edges[stretch], edges[stretch + 1]
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
