"""An effect's signature in the sensors: one stride with it, minus the same stride without it."""

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slider_jax import paper
from slider_jax.beam.parameters import Robot
from slider_jax.channels import CHANNELS
from slider_jax.effects import Prior
from slider_jax.effects.library import LIBRARY
from slider_jax.errors import SolverError
from slider_jax.experiment.load import Experiment, assemble
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.simulation.plots import title
from slider_jax.simulation.trial import TrialRun, simulate_trial

FREQUENCY = 4.8
"""Drive frequency of the built-in robot [Hz]."""
STRIDES = 8
"""Fewest strides that are simulated, so that the last one is steady."""
SMALLER = 3
"""How often a size at which the robot cannot be simulated is halved at most."""

Series = dict[str, np.ndarray]


class Trace(NamedTuple):
    """The stride with one parameter at a size, the others at their nulls."""

    parameter: str
    size: float
    unit: str
    series: Series

    @property
    def label(self) -> str:
        unit = "" if self.unit == "-" else f" {self.unit}"
        return f"{self.parameter} = {self.size:.3g}{unit}"


class Fingerprint(NamedTuple):
    """One stride of an experiment's first trial, without an effect and with it."""

    effect: str
    run: TrialRun
    """Without the effect."""
    along: np.ndarray
    """Phase of the stride; time [s] where the drive has no frequency."""
    without: Series
    """By column of `CHANNELS`, in SI units."""
    traces: tuple[Trace, ...]

    def left(self, trace: Trace) -> Series:
        """With the effect minus without it, by column, in SI units."""
        return {name: trace.series[name] - x for name, x in self.without.items()}

    def rms(self, trace: Trace) -> dict[str, float]:
        """Root mean square of the change, by column, in SI units."""
        return {name: float(np.sqrt(np.mean(x**2))) for name, x in self.left(trace).items()}


def built_in_experiment() -> Experiment:
    """The built-in robot at 4.8 Hz as the demo runs it, long enough to be steady."""
    robot, assumed = asdict(Robot()), paper.Assumed()
    K_Q = robot.pop("K_Q")
    C_d, m_a = map(float, paper.force_coefficients(FREQUENCY))
    trial = {
        "file": "built_in.csv",
        "frequency": FREQUENCY,
        "amplitude": assumed.amplitude,
        "rear_ratio": assumed.rear_ratio,
        "phase": assumed.phase,
        "duration": STRIDES / FREQUENCY,
    }
    content = {
        "name": "built-in robot",
        "robot": {key: list(x) if isinstance(x, tuple) else x for key, x in robot.items()},
        "parameters": {"C_d": C_d, "m_a": m_a, "k": paper.PRESSURE_LAG, "K_Q": K_Q},
        "trials": [trial],
    }
    return assemble(content, "built-in robot", Path("."))


def typical(prior: Prior) -> float:
    """The end of the prior range that is not the null, the upper one of two."""
    return prior.high if prior.high != prior.null else prior.low


def fingerprint(
    experiment: Experiment, effect: str, progress: Callable[[int, int], None] | None = None
) -> Fingerprint:
    """The effect of each parameter in turn on the experiment's first trial.

    A parameter is at the end of its prior range, or as near to it as can be simulated. A trial of
    fewer than eight strides is prolonged. Raises `SolverError` if no size can be simulated.
    """
    trial = experiment.trials[0]
    if trial.frequency is not None:
        duration = max(trial.duration, STRIDES / trial.frequency)
        experiment = experiment.with_values({"trials.0.duration": duration})
    priors = LIBRARY[effect].priors()

    def run(number: int, **values: float) -> TrialRun:
        def report(done: int, total: int) -> None:
            if progress is not None:
                progress(number * total + done, (1 + len(priors)) * total)

        at = {name: prior.null for name, prior in priors.items()} | values
        content = experiment.model_dump()
        content["effects"] = [*content["effects"], {"name": effect, **at}]
        prolonged = assemble(content, effect, experiment.folder)
        return simulate_trial(prolonged, progress=report, as_meant=True)

    without = run(0)
    shown = _last_stride(without)
    traces = []
    for number, (name, prior) in enumerate(priors.items(), start=1):
        size, with_it = _largest(partial(run, number), name, prior)
        traces.append(Trace(name, size, prior.unit, _cut(with_it, shown)))
    along = without.t[shown]
    if without.grid.half_period is not None:
        along = (along - along[0]) / (2 * without.grid.half_period * without.grid.h)
    return Fingerprint(effect, without, along, _cut(without, shown), tuple(traces))


def _largest(run: Callable[..., TrialRun], name: str, prior: Prior) -> tuple[float, TrialRun]:
    size = typical(prior)
    for halved in range(SMALLER + 1):
        try:
            return size, run(**{name: size})
        except SolverError:
            if halved == SMALLER:
                raise
            size = prior.null + 0.5 * (size - prior.null)
    raise AssertionError


def _last_stride(run: TrialRun) -> slice:
    """Steps of the last whole stride, both ends included; the last second without a frequency."""
    half = run.grid.half_period
    length = 2 * half if half else round(1.0 / run.grid.h)
    end = run.grid.steps // length * length if half else run.grid.steps
    return slice(max(0, end - length), end + 1)


def _cut(run: TrialRun, shown: slice) -> Series:
    return {channel.column: run.series[name][shown] for name, channel in CHANNELS.items()}


def plot_fingerprint(shown: Fingerprint, path: Path) -> None:
    """Draw each channel without and with the effect, and beside it the difference."""
    kind = LIBRARY[shown.effect]
    figure, axes = new_figure(len(CHANNELS), 2, figsize=(11, 10), sharex=True)
    for (left, right), channel in zip(axes, CHANNELS.values(), strict=True):
        name, unit, factor = channel.column, channel.plot_unit, channel.plot_factor
        left.plot(shown.along, factor * shown.without[name], color="0.65", lw=2.2, label="without")
        sizes = []
        for number, trace in enumerate(shown.traces):
            colour, change = f"C{number}", factor * shown.left(trace)[name]
            left.plot(shown.along, factor * trace.series[name], colour, lw=1.1, label=trace.label)
            right.plot(shown.along, change, colour, lw=1.1)
            sizes.append(f"{factor * shown.rms(trace)[name]:.4g}")
        unseen = all(not shown.left(trace)[name].any() for trace in shown.traces)
        size = "unchanged" if unseen else f"{', '.join(sizes)} {unit} rms"
        right.set_title(size, fontsize="small", loc="right")
        if unseen:
            right.set_ylim(-1.0, 1.0)
            right.set_yticks([0.0])
        left.set_ylabel(f"{channel.label} ({unit})")
        right.set_ylabel(f"change ({unit})")
        for ax in (left, right):
            ax.axhline(0.0, color="k", lw=0.4)
            ax.margins(x=0.0)
    above = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "fontsize": "small"}
    axes[0, 0].legend(ncols=1 + len(shown.traces), frameon=False, **above)
    steady = shown.run.grid.half_period is not None
    for ax in axes[-1]:
        ax.set_xlabel("phase of the last stride (-)" if steady else "time (s)")
    figure.align_ylabels()
    figure.suptitle(f"{shown.effect}: {kind.title}\n{title(shown.run)}", fontsize="medium")
    save_figure(figure, path)
