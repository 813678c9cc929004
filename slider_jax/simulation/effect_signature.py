"""Computes the signature of an effect: the change of one stride's readings due to the effect."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slider_jax import paper
from slider_jax.beam.parameters import SLIDER
from slider_jax.effects import Prior
from slider_jax.effects.library import LIBRARY
from slider_jax.errors import SolverError
from slider_jax.experiment.load import Experiment, assemble
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.simulation.plots import run_title
from slider_jax.simulation.trial import TrialRun, simulate_trial

FREQUENCY = 4.8
"""Drive frequency of the built-in robot [Hz]."""
STRIDES = 8
"""Smallest number of simulated strides, so that the last stride is steady."""
MAX_HALVINGS = 3
"""Largest number of halvings of a parameter's distance from its null after failed simulations."""

Series = dict[str, np.ndarray]
"""Readings (n,) of a stride in SI units, by CSV column of the channels."""


class Trace(NamedTuple):
    """The last stride with one `parameter` at `size` and the effect's other parameters at null."""

    parameter: str
    size: float
    unit: str
    series: Series

    @property
    def label(self) -> str:
        unit = "" if self.unit == "-" else f" {self.unit}"
        return f"{self.parameter} = {self.size:.3g}{unit}"


class EffectSignature(NamedTuple):
    """The last stride of an experiment's first trial, without and with an effect."""

    effect: str
    run: TrialRun
    """The simulation without the effect."""
    phase: np.ndarray
    """Phase (n,) in the stride, as a fraction of a period; time [s] for a recorded drive."""
    without: Series
    """Readings of the stride without the effect."""
    traces: tuple[Trace, ...]

    def change(self, trace: Trace) -> Series:
        """Returns the readings with the effect minus the readings without the effect."""
        return {name: trace.series[name] - x for name, x in self.without.items()}

    def rms(self, trace: Trace) -> dict[str, float]:
        """Returns the root mean square of the change of each column, in SI units."""
        return {name: float(np.sqrt(np.mean(x**2))) for name, x in self.change(trace).items()}


def built_in_experiment() -> Experiment:
    """Returns an experiment with the built-in robot and one trial of eight strides at 4.8 Hz."""
    robot, assumed = dict(SLIDER), paper.Assumed()
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
        "robot": robot,
        "parameters": {"C_d": C_d, "m_a": m_a, "k": paper.PRESSURE_LAG, "K_Q": K_Q},
        "trials": [trial],
    }
    return assemble(content, "built-in robot", Path("."))


def typical_size(prior: Prior) -> float:
    """Returns the upper end of the prior range, or the lower end if the upper end is the null."""
    return prior.high if prior.high != prior.null else prior.low


def effect_signature(
    experiment: Experiment, effect: str, progress: Callable[[int, int], None] | None = None
) -> EffectSignature:
    """Returns the signature of an effect in the experiment's first trial, for each parameter.

    Each parameter has its `typical_size`. If the simulation fails, the parameter's distance from
    its null is halved, up to three times. Raises `SolverError` if the last simulation also fails. A
    trial of fewer than eight strides is extended to eight strides.
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
        with_effect = assemble(content, effect, experiment.folder)
        return simulate_trial(with_effect, progress=report, declared_drive=True)

    without = run(0)
    shown = _last_stride(without)
    traces = []
    for number, (name, prior) in enumerate(priors.items(), start=1):
        size, with_it = _largest(partial(run, number), name, prior)
        traces.append(Trace(name, size, prior.unit, _cut(with_it, shown)))
    phase = without.t[shown]
    if without.grid.half_period is not None:
        phase = (phase - phase[0]) / (without.grid.stride * without.grid.h)
    return EffectSignature(effect, without, phase, _cut(without, shown), tuple(traces))


def _largest(run: Callable[..., TrialRun], name: str, prior: Prior) -> tuple[float, TrialRun]:
    size = typical_size(prior)
    for _ in range(MAX_HALVINGS):
        try:
            return size, run(**{name: size})
        except SolverError:
            size = prior.null + 0.5 * (size - prior.null)
    return size, run(**{name: size})


def _last_stride(run: TrialRun) -> slice:
    """Returns the steps of the last whole stride, or of the last second of a recorded drive."""
    length, end = run.grid.stride, run.grid.steps
    if run.grid.half_period:
        end = end // length * length
    return slice(max(0, end - length), end + 1)


def _cut(run: TrialRun, shown: slice) -> Series:
    channels = run.prepared.channels
    return {channel.column: run.series[name][shown] for name, channel in channels.items()}


def plot_signature(shown: EffectSignature, path: Path) -> None:
    """Draws each channel without and with the effect (left), and the difference (right)."""
    channels = shown.run.prepared.channels
    figure, axes = new_figure(len(channels), 2, figsize=(11, 2.0 * len(channels)), sharex=True)
    for (left, right), channel in zip(axes, channels.values(), strict=True):
        name, unit, factor = channel.column, channel.plot_unit, channel.plot_factor
        left.plot(shown.phase, factor * shown.without[name], color="0.65", lw=2.2, label="without")
        sizes = []
        for number, trace in enumerate(shown.traces):
            colour, change = f"C{number}", factor * shown.change(trace)[name]
            left.plot(shown.phase, factor * trace.series[name], colour, lw=1.1, label=trace.label)
            right.plot(shown.phase, change, colour, lw=1.1)
            sizes.append(f"{factor * shown.rms(trace)[name]:.4g}")
        unseen = all(not shown.change(trace)[name].any() for trace in shown.traces)
        size = "unchanged" if unseen else f"{', '.join(sizes)} {unit} rms"
        right.set_title(size, fontsize="small", loc="right")
        if unseen:
            right.set(ylim=(-1.0, 1.0), yticks=[0.0])
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
    figure.suptitle(
        f"{shown.effect}: {LIBRARY[shown.effect].title}\n{run_title(shown.run)}", fontsize="medium"
    )
    save_figure(figure, path)
