"""Measures false alarms and interval coverage of the loop on tanks without a missing effect."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import other_methods
from tanks import noisy_records, problem_of, sample_tank, true_readings

from calibration.discrepancy import report
from calibration.discrepancy.close_loop import LoopOutcome, choose_held_out, conclude
from calibration.discrepancy.refits import effect_tangents
from calibration.inference.gauss_newton import fit_gauss_newton
from calibration.inference.problem import AbstractProblem, TankProblem
from calibration.inference.uncertainty import confidence_interval, hausman_check
from calibration.measurements.records import Record
from calibration.model.extended import (
    BASE,
    base_values,
    base_vector,
    candidate_effects,
    model_parameters,
)

TANKS, REPLICATES = 6, 18
SEED = 100
COVERED, FIRST_COVERED = 104, 2000
"""Number of tanks for the interval coverage, and the seed of the first tank."""
COMPARED = 6
"""The other methods run on this number of replicates of each tank."""


@dataclass
class MemoryCache:
    """A cache of simulations, because the other methods repeat the loop's simulations."""

    results: dict[bytes, list[np.ndarray]] = field(default_factory=dict)

    def cached(self, name, arrays, make):
        key = name.encode() + b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)
        if key not in self.results:
            self.results[key] = make()
        return self.results[key]


def interval_record(interval: tuple[float, float, float], truth: float) -> dict[str, float]:
    """Returns a fitted parameter's interval and true value."""
    value, low, high = interval
    return {"value": value, "low": low, "high": high, "truth": truth}


def outcome_record(outcome: LoopOutcome, truth: Mapping[str, float]) -> dict[str, Any]:
    """Returns the loop's verdict, and the intervals and true values of the base parameters."""
    cover = {}
    for i, p in enumerate(outcome.entries):
        if p.name in truth and not p.effect:
            cover[p.name] = interval_record(outcome.interval(i), truth[p.name])
            place = int(np.flatnonzero(outcome.final.free == i)[0])
            cover[p.name]["noise_error"] = float(np.sqrt(outcome.final.covariance[place, place]))
    return {
        "verdict": outcome.verdict,
        "effects": report.effect_records(outcome),
        "where": report.residual_records(outcome),
        "candidates": [row for row in report.candidate_records(outcome) if "explained" in row],
        "parameters": cover,
        "converged": outcome.final.converged,
    }


@dataclass(frozen=True, kw_only=True)
class LinearisedProblem(AbstractProblem):
    """A problem linearised about the parameters `about`, so that thousands of fits are fast."""

    tank: TankProblem
    about: np.ndarray = field(default_factory=lambda: np.zeros(0))
    readings: tuple[np.ndarray, ...] = ()
    """Readings at `about`."""
    slopes: tuple[np.ndarray, ...] = ()

    def _predict(self, theta):
        step = theta - self.about
        pairs = zip(self.readings, self.slopes, strict=True)
        return [y + np.tensordot(step, J, 1) for y, J in pairs]

    def _tangents(self, theta, directions):
        return [np.tensordot(directions, J, 1) for J in self.slopes]

    def _coarse(self, thetas):
        return [np.stack(x) for x in zip(*(self._predict(t) for t in thetas), strict=True)]

    def spans(self):
        return self.tank.spans()


def replicates(seed: int, progress) -> dict[str, Any]:
    """Returns the loop's outcomes for replicates of the noise on one tank without missing effects.

    The model is linearised about the fit to data without noise. The complete search runs on every
    replicate.
    """
    tank, names = sample_tank(seed), tuple(candidate_effects())
    entries = model_parameters(names)
    base, memo = base_values(tank.experiment), MemoryCache()
    true = true_readings(tank, {})
    progress("calibrating without noise")
    quiet = [replace(r, values=y) for r, y in zip(noisy_records(tank, true, 0), true, strict=True)]
    problem = problem_of(tank, names, memo)(quiet)
    best = fit_gauss_newton(
        problem, entries, base_vector(entries, base), np.arange(len(BASE)), progress
    )
    progress("tangents along all parameters")
    slopes = effect_tangents(problem, entries, best.theta, best.free)
    parts = {r.trial.file: i for i, r in enumerate(quiet)}
    rows = []
    for replicate in range(REPLICATES):
        found = noisy_records(tank, true, 1000 * seed + replicate)

        def linear(chosen: list[Record]) -> AbstractProblem:
            problem = TankProblem.of(tank.experiment, list(chosen), names)
            index = [parts[r.trial.file] for r in chosen]
            return LinearisedProblem(
                records=problem.records,
                channels=problem.channels,
                noise=problem.noise,
                tank=problem,
                about=best.theta,
                readings=tuple(best.predicted[i] for i in index),
                slopes=tuple(slopes[i] for i in index),
            )

        held = choose_held_out(found)
        args = (tank.experiment, names, found, held, linear, base, tuple(BASE))
        outcome = conclude(*args, lambda text: None)
        rows.append(outcome_record(outcome, tank.truth))
        if replicate < COMPARED:
            seen = linear([r for i, r in enumerate(found) if i not in held])
            s = other_methods.method_input(seen, seen, entries, outcome.search.base)
            rows[-1]["named_by"] = {
                "sparse": other_methods.sparse(s).effects,
                "stepwise": other_methods.stepwise(s).effects,
            }
        progress(f"replicate {replicate}: {rows[-1]['verdict']}")
    bias = {p.name: float(best.theta[i]) for i, p in enumerate(entries[: len(BASE)])}
    return {"replicates": rows, "without_noise": bias, "truth": tank.truth}


def coverage(seed: int, progress) -> dict[str, Any]:
    """Returns the base parameters' intervals of one tank, as `slider calibrate` computes them."""
    tank = sample_tank(seed)
    entries = model_parameters(())
    found = noisy_records(tank, true_readings(tank, {}, names=()), seed)
    problem = problem_of(tank, ())(found)
    start = base_vector(entries, base_values(tank.experiment))
    best = hausman_check(problem, fit_gauss_newton(problem, entries, start, np.arange(len(BASE))))
    progress("calibrated")
    names = enumerate(p.name for p in entries)
    return {
        "parameters": {
            n: interval_record(confidence_interval(best, entries, i), tank.truth[n])
            for i, n in names
        }
    }
