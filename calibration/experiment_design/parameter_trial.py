"""Proposes the trial that is predicted to narrow the 95 % interval of a fitted parameter most.

A trial adds the Fisher information J J^T to the information of the measured data. J contains the
whitened tangents of the trial's readings. The inverse of the sum gives the predicted interval.
"""

from collections.abc import Callable, Iterable, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from calibration.experiment_design.information import SensorModel, TrialInformation, information
from calibration.experiment_design.trial_search import phase_of_last
from calibration.inference.gauss_newton import Fit, inverse
from calibration.inference.noise import Noise
from calibration.inference.problem import AbstractProblem, summed
from calibration.inference.uncertainty import (
    confidence_interval,
    determined,
    discretisation_share,
    value_by_variation,
)
from calibration.model.compiled import on_all_cores
from calibration.model.extended import Parameter
from calibration.model.plan import COARSE, Resolution
from slider_jax.errors import SolverError
from slider_jax.experiment.drive import ratios_of
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.schema import Trial

GRID_FREQUENCIES, GRID_STRIDES, MIN_SECONDS = 4, 3.0, 2.0
"""Number of drive frequencies to compare; strides and smallest duration [s] of a proposed trial."""


class Proposal(NamedTuple):
    """A proposed trial, and the interval of one parameter that is predicted for this trial."""

    trial: Trial
    half_width: float
    """Half width of the predicted 95 % interval, in the SI unit of the parameter."""
    determined: bool
    """Whether the predicted interval is narrow enough to determine the parameter."""


class MeasuredInformation(NamedTuple):
    """Fisher information of the measured trials, and the sensors of these trials."""

    information: np.ndarray
    """Fisher information (k, k) of the k fitted parameters over the residual's mean square."""
    free: np.ndarray
    """Indices (k,) of the fitted parameters in the parameter vector."""
    sensing: SensorModel
    """Sensors. The noise of each channel is the median over the measured trials."""

    @classmethod
    def of(cls, problem: AbstractProblem, fit: Fit) -> "MeasuredInformation":
        """Returns the information and sensors of the fitted trials."""
        noise, every = {}, {}
        for channel in problem.channels:
            found = [
                x._replace(white=float(np.median(x.white)))
                for (_, name), x in problem.noise.items()
                if name == channel
            ]
            if not found:
                continue
            there = np.concatenate([r.there(channel) for r in problem.records if r.has(channel)])
            noise[channel] = Noise(*np.median(np.array(found), axis=0))
            every[channel] = max(1, round(len(there) / int(there.sum())))
        A = summed(fit.blocks)[0] / fit.inflation
        return cls(A, fit.free, SensorModel(noise, every, {}))


def feasible_trials(experiment: Experiment, frequency: float | None = None) -> list[Trial]:
    """Returns square-wave trials within the ranges of the experiment's own trials.

    The trials combine four frequencies, or the given `frequency` [Hz], with the smallest and the
    largest amplitude, phase of the last chamber, and tow speed of the experiment. If the experiment
    has a single frequency, the four frequencies range from half to twice that frequency.
    """
    driven = [x for x in experiment.trials if x.frequency is not None]
    if not driven:
        return []
    own = _ends(x.frequency for x in driven)
    low, high = own[0], own[-1]
    if high < 1.05 * low:
        low, high = 0.5 * low, min(2.0 * high, 20.0)
    grid = np.geomspace(low, high, GRID_FREQUENCIES)
    frequencies = grid if frequency is None else [frequency]
    amplitudes = _ends(x.amplitude for x in driven)
    count = len(experiment.chambers)
    phases = _ends(phase_of_last(experiment, x) for x in driven)
    speeds = _ends(x.tow_speed for x in driven)
    how: dict[str, Any] = {"rear_ratio": float(np.median([x.rear_ratio for x in driven]))}
    if any(x.ratios is not None for x in driven):
        how = {
            "ratios": tuple(map(float, np.median([ratios_of(x, count) for x in driven], axis=0)))
        }
    return [
        Trial(
            file="proposed.csv",
            frequency=float(f) if frequency else round(float(f), 2),
            amplitude=amplitude,
            phase=phase,
            **how,
            tow_speed=speed,
            duration=round(max(MIN_SECONDS, GRID_STRIDES / f), 2),
        )
        for f, amplitude, phase, speed in product(frequencies, amplitudes, phases, speeds)
    ]


def _ends(values: Iterable[float | None]) -> list[float]:
    found = [x for x in values if x is not None]
    return sorted({min(found), max(found)})


def best_trial(
    experiment: Experiment,
    entries: Sequence[Parameter],
    theta: np.ndarray,
    wanted: Sequence[int],
    candidates: Sequence[Trial],
    measured: MeasuredInformation,
    resolution: Resolution = COARSE,
) -> dict[int, Proposal]:
    """Returns, for each parameter index in `wanted`, the trial that narrows the interval most.

    The predicted interval results from a joint fit of all free parameters to the measured data and
    to one of the `candidates`. Candidates that cannot be simulated are skipped.
    """
    effects = tuple(dict.fromkeys(p.effect for p in entries if p.effect))
    model = TrialInformation(
        experiment, effects, theta, measured.free, measured.sensing, {}, resolution
    )

    def variance(trial: Trial) -> np.ndarray:
        try:
            A = measured.information + information(model.trial(trial))
        except SolverError:
            A = np.full_like(measured.information, np.nan)
        return np.diag(inverse(A)) if np.isfinite(A).all() else np.full(len(A), np.inf)

    variances = on_all_cores(variance, list(candidates))
    best = {}
    for index in wanted:
        column = [v[np.flatnonzero(measured.free == index)[0]] for v in variances]
        if not column or not np.isfinite(min(column)):
            continue
        first = int(np.argmin(column))
        p, value = entries[index], float(theta[index])
        half = 1.96 * float(np.hypot(np.sqrt(column[first]), discretisation_share(p) * value))
        best[index] = Proposal(candidates[first], half, determined(p, value - half, value + half))
    return best


def propose_trials(
    experiment: Experiment,
    entries: Sequence[Parameter],
    problem: AbstractProblem,
    fit: Fit,
    resolution: Resolution = COARSE,
    progress: Callable[[str], None] = lambda text: None,
) -> dict[int, Proposal]:
    """Returns a proposal for every fitted parameter that the data do not determine."""
    wanted = [
        int(i)
        for i in fit.free
        if not determined(entries[i], *confidence_interval(fit, entries, int(i))[1:])
        and value_by_variation(fit, int(i)) is None  # None: mean forces do not shift the estimate
    ]
    candidates = feasible_trials(experiment) if wanted else []
    if not candidates:
        return {}
    names = ", ".join(entries[i].label for i in wanted)
    progress(f"the data do not determine {names}; comparing {len(candidates)} possible trials")
    measured = MeasuredInformation.of(problem, fit)
    return best_trial(experiment, entries, fit.theta, wanted, candidates, measured, resolution)


def proposal_record(x: Proposal) -> dict[str, Any]:
    """Returns a proposal in the form that calibration.json contains."""
    keys = ("frequency", "amplitude", "rear_ratio", "phase", "tow_speed", "duration")
    own = {} if x.trial.ratios is None else {"ratios": x.trial.ratios}
    return {
        "trial": {name: getattr(x.trial, name) for name in keys} | own,
        "half_width": x.half_width,
        "determined": x.determined,
    }


def proposal_sentence(p: Parameter, x: Proposal) -> str:
    """Returns the proposed trial and the predicted interval of the parameter `p` as text."""
    t = x.trial
    assert t.frequency is not None and t.amplitude is not None
    tow = f", towed at {t.tow_speed:g} m/s" if t.tow_speed else ", in still water"
    how = (
        f"{t.duration:g} s at {t.frequency:g} Hz, {t.amplitude / 1e3:.0f} kPa, phase "
        f"{t.phase:g}{tow}"
    )
    to = f"{p.label} to ±{x.half_width:.2g} {p.prior.unit}".rstrip(" -")
    if x.determined:
        return f"a trial of {how}, would determine {to}"
    return f"no trial in the experiment's ranges is sufficient; the best ({how}) would narrow {to}"
