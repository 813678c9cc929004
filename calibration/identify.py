"""Identify parameters of a model from measured trials, without asking what it lacks."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from calibration.audit import audit
from calibration.evidence import Problem
from calibration.findings import Finding
from calibration.fit import Fit, fit
from calibration.forward import CHANNELS, COARSE, FINE, Resolution
from calibration.measured import Record
from calibration.plant import BASE, Parameter, parameters, start
from calibration.report import UNITS, told, toml
from calibration.systematic import correlations, determined, interval
from calibration.verdict import floors, rms_errors
from slider_jax.effects.library import LIBRARY
from slider_jax.errors import InputError
from slider_jax.experiment import Experiment
from slider_jax.provenance import versions


class Identified(NamedTuple):
    """A fit of chosen parameters, and the model before it."""

    experiment: Experiment
    entries: list[Parameter]
    problem: Problem
    before: list[np.ndarray]
    """Readings (5, samples) of every trial with the experiment's own numbers."""
    fit: Fit
    audit: list[Finding]
    """What is wrong with the data, and what was done about it."""


def identify(
    experiment: Experiment,
    effects: Sequence[str] = (),
    channels: Sequence[str] = CHANNELS,
    progress: Callable[[str], None] = lambda text: None,
    fine: Resolution = FINE,
    coarse: Resolution = COARSE,
) -> Identified:
    """Fit C_d, m_a, k, K_Q and the parameters of `effects` to all measured trials.

    Raises `InputError` for an unknown effect or channel, and where no measured trial can be used.
    """
    for name in effects:
        if name not in LIBRARY:
            raise InputError(f"--also {name}: unknown effect; allowed what slider effects lists")
    for name in channels:
        if name not in CHANNELS:
            raise InputError(f"--channels {name}: unknown; allowed {', '.join(CHANNELS)}")
    entries = parameters(tuple(effects))

    def problem_of(chosen: Sequence[Record]) -> Problem:
        names, seen = tuple(effects), tuple(channels)
        return Problem.of(experiment, list(chosen), names, seen, fine, coarse)

    base = start(entries, {n: getattr(experiment.parameters, n) for n in BASE})
    begun = base.copy()
    for i, p in enumerate(entries):
        if p.effect:  # off its null, where a bound would hold it
            begun[i] += 0.02 * (p.prior.high - p.prior.low)
    progress("auditing the data")
    audited = audit(experiment, 1, lambda few: problem_of(few).predict(base))
    for finding in audited.findings:
        progress(str(finding))
    problem = problem_of(audited.records)
    before = problem.predict(base)
    return Identified(
        experiment, entries, problem, before,
        fit(problem, entries, begun, np.arange(len(entries)), progress), audited.findings,
    )  # fmt: skip


def content(found: Identified, source: dict[str, Any]) -> dict[str, Any]:
    """The content of calibration.json."""
    before, after = (rms_errors(found.problem, y) for y in (found.before, found.fit.predicted))
    floor = floors(found.problem, found.fit.predicted)
    labels = [p.label for p in found.entries]
    return {
        "parameters": {
            p.label: told(p, *interval(found.fit, found.entries, i))
            for i, p in enumerate(found.entries)
        },
        "correlations": {"order": labels, "matrix": correlations(found.fit)},
        "errors": {c: {"before": before[c], "after": after[c], "floor": floor[c]} for c in after},
        "converged": found.fit.converged,
        "mean_square_over_noise": found.fit.square / found.fit.samples,
        "trials": [r.trial.file for r in found.problem.records],
        "audit": [x.told() for x in found.audit],
        "units": UNITS,
        "input": source,
        "versions": versions(),
        "settings": found.experiment.model_dump(),
    }


def table(found: Identified) -> str:
    """What was identified, a line a parameter."""
    lines = []
    for i, p in enumerate(found.entries):
        value, low, high = interval(found.fit, found.entries, i)
        if determined(p, low, high):
            lines.append(f"{p.label:<28} {value:.4g}  ({low:.4g} to {high:.4g}) {p.prior.unit}")
        else:
            lines.append(f"{p.label:<28} not determined by these data")
    return "\n".join(lines)


def model_file(found: Identified) -> str:
    """The calibrated model, for `slider simulate --model`."""
    effects = list(dict.fromkeys(p.effect for p in found.entries if p.effect))
    said = f"Identified from {len(found.problem.records)} trials of {found.experiment.name}."
    return toml(said, found.entries, found.fit.theta, effects)
