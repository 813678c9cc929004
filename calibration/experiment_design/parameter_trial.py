"""Which single trial would fix a parameter best, before it is run.

A trial adds its own information J J^T, from tangents at the parameters found so far and the noise
that is declared, to that of the data at hand; the interval that follows is known before anything is
measured.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from calibration.inference.gauss_newton import Fit, inverse
from calibration.inference.noise import Noise, Whitener
from calibration.inference.problem import AbstractProblem
from calibration.inference.uncertainty import (
    confidence_interval,
    determined,
    discretisation_share,
    value_by_variation,
)
from calibration.model.extended import Parameter
from calibration.model.initial_swing import declared_spans
from calibration.model.predict import (
    COARSE,
    Resolution,
    on_all_cores,
    plan,
    predict,
    tangents,
)
from slider_jax.channels import row_of
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.schema import Trial

FREQUENCIES, STRIDES, SHORTEST = 4, 3.0, 2.0
"""Frequencies in the default grid; strides of a proposed trial, and its least duration [s]."""


class Proposal(NamedTuple):
    """A trial, and the interval that a parameter would have with it."""

    trial: Trial
    half_width: float
    """Of the 95 % interval, SI."""
    determined: bool
    """Whether that would be narrow enough to print a value."""


class Known(NamedTuple):
    """What is known before the trial is run."""

    information: np.ndarray
    """J J^T (k, k) of the data at hand, of the free entries."""
    free: np.ndarray
    """Indices (k,) of the entries that are identified."""
    noise: Mapping[str, tuple[Noise, int]]
    """Of every channel that is measured: its noise, and how many of the sensors' samples there are
    to one of the channel's."""

    @classmethod
    def of(cls, problem: AbstractProblem, fit: Fit) -> "Known":
        """From the trials that were fitted: their information at their own noise, and sensors."""
        A = np.sum([x.A for x in fit.blocks], axis=0) / fit.inflation
        return cls(A, fit.free, {c: x for c in problem.channels if (x := _sensor(problem, c))})


def _sensor(problem: AbstractProblem, channel: str) -> tuple[Noise, int] | None:
    """The channel's median noise, and one in how many samples it has."""
    found = [x for (_, name), x in problem.noise.items() if name == channel]
    if not found:
        return None
    there = np.concatenate([r.there(channel) for r in problem.records if r.has(channel)])
    noise = Noise(*np.median(np.array(found), axis=0))
    return noise, max(1, round(len(there) / int(there.sum())))


def feasible(experiment: Experiment, frequency: float | None = None) -> list[Trial]:
    """Square-wave trials within what the experiment's own trials span.

    Four frequencies from its lowest to its highest, or the `frequency` given, its least and largest
    amplitude, phases and tow speeds. Where it has one frequency only, half and double of it count
    as feasible.
    """
    driven = [x for x in experiment.trials if x.frequency is not None]
    low, high = _span(x.frequency for x in driven)
    if not driven:
        return []
    if high < 1.05 * low:
        low, high = 0.5 * low, min(2.0 * high, 20.0)
    frequencies = np.geomspace(low, high, FREQUENCIES) if frequency is None else [frequency]
    amplitudes = _ends(x.amplitude for x in driven)
    phases = _ends(x.phase for x in driven)
    speeds = _ends(x.tow_speed for x in driven)
    ratio = float(np.median([x.rear_ratio for x in driven]))
    return [
        Trial(
            file="proposed.csv",
            frequency=float(f) if frequency else round(float(f), 2),
            amplitude=amplitude,
            rear_ratio=ratio,
            phase=phase,
            tow_speed=speed,
            duration=round(max(SHORTEST, STRIDES / f), 2),
        )
        for f, amplitude, phase, speed in product(frequencies, amplitudes, phases, speeds)
    ]


def _span(values: Iterable[float | None]) -> tuple[float, float]:
    found = [x for x in values if x is not None]
    return (min(found), max(found)) if found else (0.0, 0.0)


def _ends(values: Iterable[float | None]) -> list[float]:
    return sorted(set(_span(values)))


def best_trial(
    experiment: Experiment,
    entries: Sequence[Parameter],
    theta: np.ndarray,
    wanted: Sequence[int],
    candidates: Sequence[Trial],
    known: Known,
    resolution: Resolution = COARSE,
) -> dict[int, Proposal]:
    """For every entry of `wanted` (free indices), the candidate that narrows its interval most.

    The interval is that of the data at hand and the candidate together, the other free entries
    being identified as well. Candidates whose simulation fails are passed over.
    """
    effects = tuple(dict.fromkeys(p.effect for p in entries if p.effect))

    def added(trial: Trial) -> np.ndarray:
        return _information(experiment, trial, effects, theta, known, resolution)

    variances = []
    for extra in on_all_cores(added, list(candidates)):
        sum_of = known.information + extra
        fine = np.isfinite(sum_of).all()
        variances.append(np.diag(inverse(sum_of)) if fine else np.full(len(sum_of), np.inf))
    best = {}
    for index in wanted:
        place = int(np.flatnonzero(known.free == index)[0])
        column = [v[place] for v in variances]
        if not column or not np.isfinite(min(column)):
            continue
        first = int(np.argmin(column))
        p, value = entries[index], float(theta[index])
        half = 1.96 * float(np.hypot(np.sqrt(column[first]), discretisation_share(p) * value))
        best[index] = Proposal(candidates[first], half, determined(p, value - half, value + half))
    return best


def _information(experiment, trial, effects, theta, known: Known, resolution) -> np.ndarray:
    """J J^T (k, k) of a trial that is not yet run."""
    laid = plan(experiment, trial, effects, resolution)
    model = predict(laid, theta)
    size = len(known.free)
    if not np.isfinite(model).all():
        return np.full((size, size), np.nan)
    J = tangents(laid, theta, np.eye(len(theta))[known.free])
    found, swing = np.zeros((size, size)), declared_spans(experiment, laid, theta)
    for channel, (noise, every) in known.noise.items():
        row, at = row_of(channel), slice(None, None, every)
        swings = None if swing is None else swing[:, row, at]
        whiten = Whitener(laid.at[at], noise, model[row, at], channel, trial.frequency, swings)
        white = whiten(J[:, row, at])
        found += white @ white.T
    return found


def advise(
    experiment: Experiment,
    entries: Sequence[Parameter],
    problem: AbstractProblem,
    fit: Fit,
    resolution: Resolution = COARSE,
    progress: Callable[[str], None] = lambda text: None,
) -> dict[int, Proposal]:
    """A proposal for every fitted entry that the data do not determine."""
    open_ones = [
        int(i)
        for i in fit.free
        if not determined(entries[i], *confidence_interval(fit, entries, int(i))[1:])
        and value_by_variation(fit, int(i)) is None  # else more of the same data would not agree
    ]
    candidates = feasible(experiment) if open_ones else []
    if not candidates:
        return {}
    names = ", ".join(entries[i].label for i in open_ones)
    progress(f"{names}: not determined; looking for the trial that would, among {len(candidates)}")
    known = Known.of(problem, fit)
    return best_trial(experiment, entries, fit.theta, open_ones, candidates, known, resolution)


def described(x: Proposal) -> dict[str, Any]:
    """A proposal for a JSON file."""
    kept = ("frequency", "amplitude", "rear_ratio", "phase", "tow_speed", "duration")
    return {
        "trial": {name: getattr(x.trial, name) for name in kept},
        "half_width": x.half_width,
        "determined": x.determined,
    }


def proposal_sentence(p: Parameter, x: Proposal) -> str:
    """A proposal in a sentence."""
    t = x.trial
    assert t.frequency is not None and t.amplitude is not None
    tow = f", towed at {t.tow_speed:g} m/s" if t.tow_speed else ", in still water"
    how = (
        f"{t.duration:g} s at {t.frequency:g} Hz, {t.amplitude / 1e3:.0f} kPa, phase "
        f"{t.phase:g}{tow}"
    )
    to = f"{p.label} to ±{x.half_width:.2g} {p.prior.unit}".rstrip(" -")
    if x.determined:
        return f"a trial of {how}, would give {to}"
    return f"no trial within this experiment's limits determines it; the best, {how}, gives {to}"
