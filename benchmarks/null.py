"""Tanks that lack nothing: what the loop says of many draws of noise; how wide intervals are."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import rivals
from tanks import draw, noisy, problem_of, simulated

from calibration.discrepancy import report
from calibration.discrepancy.close_loop import LoopOutcome, choose_held_out, conclude
from calibration.discrepancy.selection import effect_tangents
from calibration.inference.gauss_newton import fit_gauss_newton
from calibration.inference.problem import AbstractProblem, TankProblem
from calibration.inference.uncertainty import confidence_interval, hausman_check
from calibration.measurements.records import Record
from calibration.model.extended import BASE, base_values, base_vector, candidates, parameters

TANKS, REPLICATES = 6, 18
SEED = 100
COVERED, FIRST = 104, 2000
"""Tanks whose intervals are held against the truth, and the first one's seed."""
RIVALS = 6
"""Replicates of each tank on which the other ways speak too."""


@dataclass
class Kept:
    """What was simulated, in memory: the rivals ask again for what the loop asked."""

    found: dict[bytes, list[np.ndarray]] = field(default_factory=dict)

    def kept(self, name, arrays, make):
        key = name.encode() + b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)
        if key not in self.found:
            self.found[key] = make()
        return self.found[key]


def told(interval: tuple[float, float, float], truth: float) -> dict[str, float]:
    """A fitted parameter's interval beside the truth."""
    value, low, high = interval
    return {"value": value, "low": low, "high": high, "truth": truth}


def summary(outcome: LoopOutcome, truth: Mapping[str, float]) -> dict[str, Any]:
    """What was said, and whether the base parameters' intervals hold the truth."""
    cover = {}
    for i, p in enumerate(outcome.entries):
        if p.name in truth and not p.effect:
            cover[p.name] = told(outcome.interval(i), truth[p.name])
            place = int(np.flatnonzero(outcome.final.free == i)[0])
            cover[p.name]["noise_error"] = float(np.sqrt(outcome.final.covariance[place, place]))
    return {
        "verdict": outcome.verdict,
        "effects": report.effect_records(outcome),
        "nearest": report.nearest_effects(outcome),
        "where": report.residual_records(outcome),
        "candidates": [row for row in report.candidate_records(outcome) if "explained" in row],
        "parameters": cover,
        "converged": outcome.final.converged,
    }


@dataclass(frozen=True, kw_only=True)
class Linear(AbstractProblem):
    """Readings that are linear about a vector: thousands of fits for the price of one."""

    tank: TankProblem
    about: np.ndarray = field(default_factory=lambda: np.zeros(0))
    there: tuple[np.ndarray, ...] = ()
    slopes: tuple[np.ndarray, ...] = ()

    def _predict(self, theta):
        step = theta - self.about
        return [y + np.tensordot(step, J, 1) for y, J in zip(self.there, self.slopes, strict=True)]

    def _tangents(self, theta, directions):
        return [np.tensordot(directions, J, 1) for J in self.slopes]

    def _secants(self, theta, others):
        return self._tangents(theta, np.stack(others) - theta)

    def spans(self):
        return self.tank.spans()


def replicates(seed: int, progress) -> dict[str, Any]:
    """Verdicts on replicates of the noise on one tank that lacks nothing.

    The model is linearised about its fit to the tank without noise. All of the search runs on every
    replicate.
    """
    tank, names = draw(seed), tuple(candidates())
    entries = parameters(names)
    base, memo = base_values(tank.experiment), Kept()
    true = simulated(tank, {})
    progress("calibrating without noise")
    quiet = [replace(r, values=y) for r, y in zip(noisy(tank, true, 0), true, strict=True)]
    laid = problem_of(tank, names, memo)(quiet)
    best = fit_gauss_newton(
        laid, entries, base_vector(entries, base), np.arange(len(BASE)), progress
    )
    progress("tangents along everything")
    slopes = effect_tangents(laid, entries, best.theta, best.free)
    parts = {r.trial.file: i for i, r in enumerate(quiet)}
    rows = []
    for replicate in range(REPLICATES):
        found = noisy(tank, true, 1000 * seed + replicate)

        def linear(chosen: list[Record]) -> AbstractProblem:
            laid = TankProblem.of(tank.experiment, list(chosen), names)
            index = [parts[r.trial.file] for r in chosen]
            return Linear(
                records=laid.records,
                channels=laid.channels,
                noise=laid.noise,
                tank=laid,
                about=best.theta,
                there=tuple(best.predicted[i] for i in index),
                slopes=tuple(slopes[i] for i in index),
            )

        held = choose_held_out(found)
        args = (tank.experiment, names, found, held, linear, base, tuple(BASE))
        outcome = conclude(*args, lambda text: None)
        rows.append(summary(outcome, tank.truth))
        if replicate < RIVALS:
            seen = linear([r for i, r in enumerate(found) if i not in held])
            s = rivals.begin(seen, seen, entries, outcome.search.base)
            rows[-1]["named_by"] = {
                "sparse": rivals.sparse(s).effects, "stepwise": rivals.stepwise(s).effects,
            }  # fmt: skip
        progress(f"replicate {replicate}: {rows[-1]['verdict']}")
    bias = {p.name: float(best.theta[i]) for i, p in enumerate(entries[: len(BASE)])}
    return {"replicates": rows, "without_noise": bias, "truth": tank.truth}


def covered(seed: int, progress) -> dict[str, Any]:
    """Intervals of the base parameters from a tank of its own, as `slider calibrate` gives them."""
    tank = draw(seed)
    entries = parameters(())
    found = noisy(tank, simulated(tank, {}, names=()), seed)
    laid = problem_of(tank, ())(found)
    begun = base_vector(entries, base_values(tank.experiment))
    best = hausman_check(laid, fit_gauss_newton(laid, entries, begun, np.arange(len(BASE))))
    progress("calibrated")
    names = enumerate(p.name for p in entries)
    return {
        "parameters": {
            n: told(confidence_interval(best, entries, i), tank.truth[n]) for i, n in names
        }
    }
