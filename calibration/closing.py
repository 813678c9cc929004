"""Close the loop on an experiment: from measured trials to a verdict and a better model."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.audit import audit
from calibration.evidence import Problem
from calibration.findings import Finding
from calibration.fit import Fit, fit
from calibration.forward import COARSE, FINE, Resolution
from calibration.measured import Record
from calibration.plant import BASE, Parameter, candidates, parameters, start
from calibration.search import Search, search
from calibration.systematic import interval
from calibration.verdict import Excess, decide, excess, floors, rms_errors
from slider_jax.experiment import Experiment

LEAST_TRIALS = 3


@dataclass(frozen=True)
class Errors:
    """rms of measured less predicted, and the floor, of every channel in its unit."""

    before: dict[str, float]
    after: dict[str, float]
    floor: dict[str, float]


@dataclass(frozen=True)
class Outcome:
    """Everything that closing the loop found."""

    experiment: Experiment
    entries: list[Parameter]
    verdict: str
    search: Search
    final: Fit
    """The chosen model, refitted to all trials."""
    problem: Problem
    """All trials."""
    used: Errors
    held_out: Errors | None
    excess_before: dict[str, Excess]
    excess_after: dict[str, Excess]
    held: list[int]
    """Trials that the search did not see, by their place in `problem.records`."""
    audit: list[Finding]
    """What is wrong with the data, and what was done about it."""

    def interval(self, index: int) -> tuple[float, float, float]:
        """Value and 95 % interval of an entry that was fitted."""
        return interval(self.final, self.entries, index)


def choose_held_out(found: Sequence[Record]) -> list[int]:
    """A quarter of the trials, spread over the frequencies but not their ends; none of too few."""
    if len(found) < 2 * LEAST_TRIALS:
        return []
    order = sorted(range(len(found)), key=lambda i: (found[i].trial.frequency or 0.0, i))
    return sorted(order[2:-1:4])


def close_loop(
    experiment: Experiment,
    effects: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda text: None,
    fine: Resolution = FINE,
    coarse: Resolution = COARSE,
) -> Outcome:
    """Search what the model of `experiment` lacks on its measured trials.

    `effects` are the candidates' names, all of the library by default. Residuals are computed at
    the resolution `fine`, tangents at `coarse`. Raises `InputError` where fewer than
    `LEAST_TRIALS` trials can be used.
    """

    def problem_of(chosen: Sequence[Record]) -> Problem:
        return Problem.of(experiment, list(chosen), names, fine=fine, coarse=coarse)

    names = tuple(candidates() if effects is None else effects)
    entries = parameters(names)
    begun = start(entries, {n: getattr(experiment.parameters, n) for n in BASE})
    progress("auditing the data")
    audited = audit(experiment, LEAST_TRIALS, lambda few: problem_of(few).predict(begun))
    for finding in audited.findings:
        progress(str(finding))
    found = audited.records
    held = choose_held_out(found)
    seen = [r for i, r in enumerate(found) if i not in held]
    everything = problem_of(found)
    problem = problem_of(seen) if held else everything
    result = search(problem, entries, begun, progress)
    before, after = excess(problem, result.base), excess(problem, result.final)
    verdict = decide(result, before, after)
    hidden = None
    if held:
        progress("predicting the trials that were held out")
        rest = problem_of([found[i] for i in held])
        hidden = _errors(rest, *(rest.predict(f.theta) for f in (result.base, result.final)))
    progress("refitting to all trials")
    final = fit(everything, entries, result.final.theta, result.final.free, progress)
    used = _errors(problem, result.base.predicted, result.final.predicted)
    return Outcome(
        experiment, entries, verdict, result, final, everything, used, hidden, before, after, held,
        audited.findings,
    )  # fmt: skip


def _errors(problem: Problem, before: list[np.ndarray], after: list[np.ndarray]) -> Errors:
    return Errors(rms_errors(problem, before), rms_errors(problem, after), floors(problem, after))
