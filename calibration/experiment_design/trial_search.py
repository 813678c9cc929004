"""Searches for the trial that maximises a function of the predicted information.

The search evaluates evenly spread trials first. A pattern search then starts from the best trial.
The variables are frequency, amplitude, phase of the last chamber and tow speed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

from calibration.experiment_design.information import (
    ChannelInformation,
    TrialInformation,
    information,
)
from calibration.model.compiled import on_all_cores
from slider_jax.errors import InputError, SolverError
from slider_jax.experiment.drive import delays_of
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.schema import Trial
from slider_jax.io.toml import quantity_of, toml_text, validate

TRIAL_STRIDES, MAX_SECONDS, MIN_STRIDES = 6.0, 2.0, 2.0
"""A trial lasts `TRIAL_STRIDES` strides or `MAX_SECONDS` [s], whichever is shorter, but at least
`MIN_STRIDES` strides."""
WIDENING = 0.1
"""By default, the search may go beyond the range of the experiment's trials by this fraction. For
the quantities in `LOGARITHMIC`, this is a fraction of the value at the end of the range. For the
other quantities, this is a fraction of the width of the range."""
FIRST = 4
"""Number of evenly spread trials after which a search without prospects ends."""
LOGARITHMIC = ("frequency", "amplitude")  # quantities that the search spaces logarithmically
QUANTITIES = ("frequency", "amplitude", "phase", "tow_speed")


class TrialLimits(NamedTuple):
    """Ranges (low, high) that the search allows for the quantities of a trial, in SI units."""

    frequency: tuple[float, float]
    amplitude: tuple[float, float]
    phase: tuple[float, float]
    tow_speed: tuple[float, float]


class SearchEffort(NamedTuple):
    """Number `spread` of evenly spread trials, and number `rounds` of pattern-search rounds."""

    spread: int = 24
    rounds: int = 3


class PredictedTrial(NamedTuple):
    """A trial, its predicted information, and the value of the search's objective."""

    trial: Trial
    channels: list[list[ChannelInformation]]
    """Information (one entry per channel) that each model predicts for the trial."""
    value: float
    """Objective, which the search maximises; -inf if the trial cannot be simulated."""


def limits_of(
    experiment: Experiment, given: Mapping[str, tuple[float, float] | None] | None = None
) -> TrialLimits:
    """Returns the ranges `given` or, by default, the widened ranges of the experiment's trials.

    Raises `InputError` if a range is reversed, not allowed, or neither given nor in the trials.
    """
    ranges = []
    for name in QUANTITIES:
        option = f"--{name.replace('_', '-')}"
        limits = (given or {}).get(name)
        low, high = _own_range(experiment, name, option) if limits is None else limits
        if low > high:
            raise InputError.value(option, f"{low:g} {high:g}", "LOW HIGH with LOW <= HIGH")
        for value in (low, high):
            allowed = quantity_of(Trial.model_fields[name])
            if allowed and not allowed.low <= value <= allowed.high:
                raise InputError.value(option, f"{value:g}", allowed.allowed, allowed.advice)
        ranges.append((float(low), float(high)))
    return TrialLimits(*ranges)


def _own_range(experiment: Experiment, name: str, option: str) -> tuple[float, float]:
    own = [t for t in experiment.trials if t.waveform != "recorded"]
    if name == "phase":
        values = [phase_of_last(experiment, t) for t in own]
    else:
        values = [getattr(t, name) for t in own]
    if not values:
        raise InputError(
            f"{option}: no range is given, and the experiment has recorded drives only, which have "
            "no range of this quantity; give LOW HIGH"
        )
    low, high = min(values), max(values)
    more = WIDENING * ((high - low) or abs(high))
    lower, upper = (WIDENING * low, WIDENING * high) if name in LOGARITHMIC else (more, more)
    allowed = quantity_of(Trial.model_fields[name])
    assert allowed is not None

    def rounded(x: float) -> float:
        return float(np.clip(float(f"{x:.3g}"), allowed.low, allowed.high))

    # An end at zero is not widened: the gantry may be unable to tow, or tow in one direction only.
    return rounded(low - lower if low else 0.0), rounded(high + upper if high else 0.0)


def phase_of_last(experiment: Experiment, trial: Trial) -> float:
    """Returns the delay of the last chamber's set pressure, as a fraction of a period."""
    return next(reversed(delays_of(trial, len(experiment.chambers))), 0.0)


def trial_at(experiment: Experiment, limits: TrialLimits, point: np.ndarray) -> Trial:
    """Returns the rounded trial at `point` (4,). An entry of 0 or 1 is the low or high limit.

    The other keys of the drive are those of the first trial. The delay changes linearly from the
    first chamber to the last.
    """
    own = [t for t in experiment.trials if t.waveform != "recorded"]
    x = {}
    for name, (low, high), u in zip(QUANTITIES, limits, point, strict=True):
        scaled = name in LOGARITHMIC and low > 0.0
        value = low * (high / low) ** u if scaled else low + u * (high - low)
        x[name] = float(np.clip(float(f"{value:.3g}"), low, high))
    period = 1.0 / x["frequency"]
    seconds = max(MIN_STRIDES * period, min(TRIAL_STRIDES * period, MAX_SECONDS))
    like = {"waveform", "rear_ratio", "ratios", "biases", "effort"}
    like |= {"rise"} if own[0].waveform == "trapezoid" else set()
    file = {"file": unused_file_name(experiment), "duration": float(f"{seconds:.3g}")}
    return validate(Trial, file | own[0].model_dump(include=like) | x, "next trial")


def unused_file_name(experiment: Experiment) -> str:
    """Returns a file name that no trial and no file in the experiment's folder has."""
    taken = {t.file for t in experiment.trials}
    number = len(experiment.trials)
    while (name := f"trial_{number:02d}.csv") in taken or (experiment.folder / name).exists():
        number += 1
    return name


@dataclass(frozen=True)
class TrialSearch:
    """Search for the trial with the largest `goal`, a function of the predicted information."""

    predictions: Sequence[TrialInformation]
    goal: Callable[[list[list[ChannelInformation]]], float]
    limits: TrialLimits
    hopeless: float = -np.inf
    """The search ends after the first `FIRST` trials if no value of the goal is above this one."""

    def at(self, point: np.ndarray) -> PredictedTrial:
        """Returns the trial at a point (4,) with coordinates from 0 to 1 within the limits."""
        trial = trial_at(self.predictions[0].experiment, self.limits, point)
        try:
            channels = [f.trial(trial) for f in self.predictions]
        except SolverError:
            return PredictedTrial(trial, [], -np.inf)
        finite = all(np.isfinite(information(x)).all() for x in channels)
        return PredictedTrial(trial, channels, self.goal(channels) if finite else -np.inf)

    def run(
        self,
        effort: SearchEffort = SearchEffort(),
        progress: Callable[[str], None] = lambda text: None,
    ) -> PredictedTrial:
        """Returns the best trial. Raises `SolverError` if no trial can be simulated."""
        wide = np.array([high > low for low, high in self.limits])
        spread = qmc.Halton(4, scramble=False).fast_forward(1).random(effort.spread)
        points = [np.where(wide, u, 0.0) for u in spread]
        first = FIRST if np.isfinite(self.hopeless) else effort.spread
        best, point = self._best(points[:first], progress)
        if -np.inf < best.value <= self.hopeless:
            return best
        if points[first:]:
            more = self._best(points[first:], progress)
            best, point = max((best, point), more, key=lambda pair: pair[0].value)
        progress(f"best of {effort.spread} evenly spread trials: {trial_text(best.trial)}")
        step = 0.25
        for _ in range(effort.rounds):
            moves = [s * step * np.eye(4)[i] for i in np.flatnonzero(wide) for s in (-1.0, 1.0)]
            around = {tuple(np.clip(point + move, 0.0, 1.0)) for move in moves} - {tuple(point)}
            if not around:
                break
            better, there = self._best([np.array(x) for x in sorted(around)], progress)
            if better.value > best.value:
                best, point = better, there
                progress(f"better trial: {trial_text(best.trial)}")
            else:
                step *= 0.5
        if not np.isfinite(best.value):
            raise SolverError(
                "no trial within the limits can be simulated; lower the limits, first the limits "
                "of the amplitude"
            )
        return best

    def _best(
        self, points: list[np.ndarray], progress: Callable[[str], None]
    ) -> tuple[PredictedTrial, np.ndarray]:
        done: list[PredictedTrial] = []

        def one(point: np.ndarray) -> tuple[PredictedTrial, np.ndarray]:
            found = self.at(point)
            done.append(found)
            progress(f"trial {len(done)} of {len(points)}: {trial_text(found.trial)}")
            return found, point

        return max(on_all_cores(one, points), key=lambda pair: pair[0].value)


def trial_text(trial: Trial) -> str:
    """Returns the main settings of a trial as text."""
    if trial.frequency is None or trial.amplitude is None:
        return f"{trial.file} (recorded drive)"
    return (
        f"{trial.frequency:g} Hz, {1e-3 * trial.amplitude:g} kPa, {phase_text(trial)}, "
        f"tow speed {trial.tow_speed:g} m/s"
    )


def phase_text(trial: Trial) -> str:
    """Returns the phase, or the phases of all chambers, as text."""
    if trial.phases is None:
        return f"phase {trial.phase:g}"
    return f"phases {', '.join(f'{x:g}' for x in trial.phases)}"


def trial_table(trial: Trial) -> dict[str, Any]:
    """Returns a trial's keys: keys with non-default values, and the quantities of the search."""
    content = trial.model_dump(exclude_defaults=True)
    return content | {name: getattr(trial, name) for name in QUANTITIES}


def trial_toml(trial: Trial) -> str:
    """Returns a trial as a table to add to an experiment file."""
    return toml_text({"trials": [{k: x for k, x in trial_table(trial).items() if x is not None}]})


def next_trial_record(
    purpose: str, text: str, trial: Trial, limits: TrialLimits | None = None
) -> dict[str, Any]:
    """Returns the record of a proposed trial as in report.json; `text` gives the reason."""
    record = {
        "purpose": purpose,
        "said": text[0].upper() + text[1:],
        "trial": trial_table(trial),
        "toml": trial_toml(trial),
    }
    return record | ({"limits": limits._asdict()} if limits else {})
