"""The trial that, added to what there is, says most of what is asked.

First evenly spread trials, then a pattern search from the best of them, over frequency, amplitude,
phase of the rear chamber and tow speed.
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
from calibration.model.predict import on_all_cores
from slider_jax.errors import InputError, SolverError
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.schema import Trial
from slider_jax.io.toml import quantity_of, toml_text, validate

STRIDES, LONGEST, LEAST = 6.0, 2.0, 2.0
"""A trial lasts `STRIDES` strides, but at most `LONGEST` seconds, and at least `LEAST` strides."""
WIDER = 0.1
"""The experiment's own range is widened by so much at either end: of itself, or, as frequency and
amplitude have ranges in ratios, of the value there."""
IN_RATIOS = ("frequency", "amplitude")
QUANTITIES = ("frequency", "amplitude", "phase", "tow_speed")


class TrialLimits(NamedTuple):
    """Ranges (low, high) that a trial may be chosen from, SI."""

    frequency: tuple[float, float]
    amplitude: tuple[float, float]
    phase: tuple[float, float]
    tow_speed: tuple[float, float]


class SearchEffort(NamedTuple):
    """How many trials are tried: evenly spread ones, then rounds of the pattern search."""

    spread: int = 24
    rounds: int = 3


class PredictedTrial(NamedTuple):
    """A trial that was predicted."""

    trial: Trial
    channels: list[list[ChannelInformation]]
    """By each of the predictions."""
    value: float
    """Of the goal, the larger the better; -inf where the trial cannot be simulated."""


def limits_of(
    experiment: Experiment, given: Mapping[str, tuple[float, float] | None] | None = None
) -> TrialLimits:
    """The ranges `given`, the others from the experiment's own trials, slightly widened.

    Raises `InputError` for reversed ones, for those outside physics, and where there is neither.
    """
    ranges = []
    for name in QUANTITIES:
        option = f"--{name.replace('_', '-')}"
        asked = (given or {}).get(name)
        low, high = _own(experiment, name, option) if asked is None else asked
        if low > high:
            raise InputError.value(option, f"{low:g} {high:g}", "LOW HIGH, the lower one first")
        for value in (low, high):
            allowed = quantity_of(Trial.model_fields[name])
            if allowed and not allowed.low <= value <= allowed.high:
                raise InputError.value(option, f"{value:g}", allowed.allowed, allowed.advice)
        ranges.append((float(low), float(high)))
    return TrialLimits(*ranges)


def _own(experiment: Experiment, name: str, option: str) -> tuple[float, float]:
    values = [getattr(t, name) for t in experiment.trials if t.waveform != "recorded"]
    if not values:
        raise InputError(
            f"{option}: given nothing; the experiment has recorded drives only, so a range of its "
            "own is missing; give LOW HIGH"
        )
    low, high = min(values), max(values)
    more = WIDER * ((high - low) or abs(high))
    lower, upper = (WIDER * low, WIDER * high) if name in IN_RATIOS else (more, more)
    allowed = quantity_of(Trial.model_fields[name])
    assert allowed is not None

    def rounded(x: float) -> float:
        return float(np.clip(float(f"{x:.3g}"), allowed.low, allowed.high))

    # A tank that has never towed, or never the other way, is not taken to be able to.
    return rounded(low - lower if low else 0.0), rounded(high + upper if high else 0.0)


def proposed(experiment: Experiment, limits: TrialLimits, place: np.ndarray) -> Trial:
    """The trial at a `place` (4,) of the unit cube of the limits, in round numbers."""
    own = [t for t in experiment.trials if t.waveform != "recorded"]
    x = {
        name: float(np.clip(float(f"{_between(low, high, u, name):.3g}"), low, high))
        for name, (low, high), u in zip(QUANTITIES, limits, place, strict=True)
    }
    seconds = max(LEAST / x["frequency"], min(STRIDES / x["frequency"], LONGEST))
    content: dict[str, Any] = {"waveform": own[0].waveform, "rear_ratio": own[0].rear_ratio}
    if own[0].waveform == "trapezoid":
        content["rise"] = own[0].rise
    file = {"file": free_name(experiment), "duration": float(f"{seconds:.3g}")}
    return validate(Trial, file | content | x, "next trial")


def _between(low: float, high: float, share: float, name: str) -> float:
    if name in IN_RATIOS and low > 0.0:
        return low * (high / low) ** share
    return low + share * (high - low)


def free_name(experiment: Experiment) -> str:
    """A file name that neither a trial nor a file of the experiment's folder has."""
    taken = {t.file for t in experiment.trials}
    number = len(experiment.trials)
    while (name := f"trial_{number:02d}.csv") in taken or (experiment.folder / name).exists():
        number += 1
    return name


@dataclass(frozen=True)
class TrialSearch:
    """What a trial is chosen for: `goal` is of what it would say by each of the predictions."""

    predictions: Sequence[TrialInformation]
    goal: Callable[[list[list[ChannelInformation]]], float]
    limits: TrialLimits

    def at(self, place: np.ndarray) -> PredictedTrial:
        """The trial at a place of the unit cube."""
        trial = proposed(self.predictions[0].experiment, self.limits, place)
        try:
            channels = [f.trial(trial) for f in self.predictions]
        except SolverError:
            return PredictedTrial(trial, [], -np.inf)
        fine = all(np.isfinite(information(x)).all() for x in channels)
        return PredictedTrial(trial, channels, self.goal(channels) if fine else -np.inf)

    def run(
        self,
        effort: SearchEffort = SearchEffort(),
        progress: Callable[[str], None] = lambda text: None,
    ) -> PredictedTrial:
        """The best trial. Raises `SolverError` where none within the limits can be simulated."""
        wide = np.array([high > low for low, high in self.limits])
        places = [np.where(wide, u, 0.0) for u in _spread(effort.spread)]
        best, place = self._best(places, progress)
        progress(f"{effort.spread} trials tried; the best is {trial_text(best.trial)}")
        step = 0.25
        for _ in range(effort.rounds):
            moves = [s * step * np.eye(4)[i] for i in np.flatnonzero(wide) for s in (-1.0, 1.0)]
            around = {tuple(np.clip(place + move, 0.0, 1.0)) for move in moves} - {tuple(place)}
            if not around:
                break
            better, there = self._best([np.array(x) for x in sorted(around)], progress)
            if better.value > best.value:
                best, place = better, there
                progress(f"better: {trial_text(best.trial)}")
            else:
                step *= 0.5
        if not np.isfinite(best.value):
            raise SolverError(
                "none of the trials within the limits could be simulated; give smaller ones, "
                "of the amplitude first"
            )
        return best

    def _best(
        self, places: list[np.ndarray], progress: Callable[[str], None]
    ) -> tuple[PredictedTrial, np.ndarray]:
        done: list[PredictedTrial] = []

        def one(place: np.ndarray) -> PredictedTrial:
            found = self.at(place)
            done.append(found)
            progress(f"trial {len(done)} of {len(places)}: {trial_text(found.trial)}")
            return found

        pairs = list(zip(on_all_cores(one, places), places, strict=True))
        return max(pairs, key=lambda pair: pair[0].value)


def _spread(count: int) -> np.ndarray:
    """(count, 4) evenly spread places of the unit cube, the same every time."""
    sequence = qmc.Halton(4, scramble=False)
    sequence.fast_forward(1)
    return sequence.random(count)


def trial_text(trial: Trial) -> str:
    """A trial in a few words."""
    if trial.frequency is None or trial.amplitude is None:
        return f"{trial.file} (recorded drive)"
    return (
        f"{trial.frequency:g} Hz, {1e-3 * trial.amplitude:g} kPa, phase {trial.phase:g}, "
        f"tow speed {trial.tow_speed:g} m/s"
    )


def as_table(trial: Trial) -> dict[str, Any]:
    """A trial's keys that are not at their defaults, and the quantities that were chosen."""
    content = trial.model_dump(exclude_defaults=True)
    return content | {name: getattr(trial, name) for name in QUANTITIES}


def trial_toml(trial: Trial) -> str:
    """A trial as a table to add to an experiment file."""
    return toml_text({"trials": [{k: x for k, x in as_table(trial).items() if x is not None}]})
