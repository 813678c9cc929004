"""Identify parameters of a model from measured trials, without asking what it lacks."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from calibration.audit.audit import audit_measurements
from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.experiment_design.parameter_trial import (
    Proposal,
    proposal_record,
    proposal_sentence,
    propose_trials,
)
from calibration.inference.gauss_newton import Fit, fit_gauss_newton
from calibration.inference.goodness import excess, noise_floors, rms_errors
from calibration.inference.lbfgs import fit_lbfgs
from calibration.inference.problem import TankProblem
from calibration.inference.uncertainty import correlations, hausman_check
from calibration.measurements.findings import Finding
from calibration.measurements.records import Record
from calibration.model.extended import Parameter, base_values, base_vector, parameters
from calibration.model.predict import COARSE, FINE, Resolution
from calibration.reporting.parameters import model_tables, parameter_record, parameter_text
from slider_jax.channels import BUILT_IN, CHANNELS
from slider_jax.effects.library import LIBRARY
from slider_jax.errors import InputError, did_you_mean
from slider_jax.experiment.load import Experiment
from slider_jax.io.files import versions
from slider_jax.io.toml import toml_text

METHODS = {"lm": fit_gauss_newton, "lbfgs": fit_lbfgs}
MANY = 12
"""Free parameters from which on L-BFGS is taken where no method is named."""


class Identified(NamedTuple):
    """A fit of chosen parameters, and the model before it."""

    experiment: Experiment
    entries: list[Parameter]
    problem: TankProblem
    before: list[np.ndarray]
    """Readings (5, samples) of every trial with the experiment's own numbers."""
    fit: Fit
    method: str
    advice: dict[int, Proposal]
    """A trial for every entry that the data do not determine."""
    audit: list[Finding]
    """What is wrong with the data, and what was done about it."""
    doubt: str
    """What to know of a fit that does not explain its data, or nothing."""


def check_names(effects: Sequence[str], channels: Sequence[str], method: str) -> None:
    """Raises `InputError` for a name that `identify_parameters` does not know."""
    if method not in (*METHODS, "auto"):
        raise InputError(f"--method {method}: unknown; allowed auto, {', '.join(METHODS)}")
    for name in effects:
        if name not in LIBRARY:
            near = did_you_mean(name, LIBRARY)
            raise InputError(
                f"--also {name}: unknown effect; allowed what slider effects lists{near}"
            )
    for name in channels:
        if name not in CHANNELS:
            raise InputError(f"--channels {name}: unknown; allowed {', '.join(CHANNELS)}")


def identify_parameters(
    experiment: Experiment,
    effects: Sequence[str] = (),
    channels: Sequence[str] = BUILT_IN,
    progress: Callable[[str], None] = lambda text: None,
    fine: Resolution = FINE,
    coarse: Resolution = COARSE,
    method: str = "auto",
) -> Identified:
    """Fit C_d, m_a, k, K_Q and the parameters of `effects` to all measured trials.

    `method` is "lm", "lbfgs", or "auto": L-BFGS from `MANY` parameters on. Raises `InputError` for
    an unknown effect, channel or method, and where no measured trial can be used.
    """
    check_names(effects, channels, method)
    entries = parameters(tuple(effects))

    def problem_of(chosen: Sequence[Record]) -> TankProblem:
        names, seen = tuple(effects), tuple(channels)
        return TankProblem.of(experiment, list(chosen), names, seen, fine, coarse)

    base = base_vector(entries, base_values(experiment))
    begun = base.copy()
    for i, p in enumerate(entries):
        if p.effect:  # off its null, where a bound would hold it
            begun[i] += 0.02 * (p.prior.high - p.prior.low)
    progress("auditing the data")
    audited = audit_measurements(experiment, 1, lambda few: problem_of(few).predict(base))
    for finding in audited.findings:
        progress(str(finding))
    problem = problem_of(audited.records)
    before = problem.predict(base)
    if method == "auto":
        method = "lbfgs" if len(entries) >= MANY else "lm"
    best = METHODS[method](problem, entries, begun, np.arange(len(entries)), progress)
    best = hausman_check(problem, best)
    advice = propose_trials(experiment, entries, problem, best, coarse, progress)
    found = experiment, entries, problem, before, best, method, advice, audited.findings
    return Identified(*found, doubt(problem, best))


def doubt(problem: TankProblem, fit: Fit) -> str:
    """What to know of a fit that does not explain its data; nothing of one that does."""
    left = {
        c: x.all for c, x in excess(problem, fit).items() if x.all > DEFAULT_SETTINGS.noise_floor
    }
    if not left:
        return ""
    channels = ", ".join(f"{c} at {np.sqrt(x):.2g} times its noise" for c, x in left.items())
    return (
        f"The model does not explain these data: it leaves {channels}. Something is missing, the "
        "values make up for it, and the intervals do not hold; slider close-loop traces it."
    )


def identification_record(found: Identified, source: dict[str, Any]) -> dict[str, Any]:
    """The content of calibration.json."""
    before, after = (rms_errors(found.problem, y) for y in (found.before, found.fit.predicted))
    floor = noise_floors(found.problem, found.fit.predicted)
    labels = [p.label for p in found.entries]
    return {
        "parameters": {
            p.label: parameter_record(found.fit, found.entries, i)
            | ({"determined_by": proposal_record(found.advice[i])} if i in found.advice else {})
            for i, p in enumerate(found.entries)
        },
        "correlations": {"order": labels, "matrix": correlations(found.fit)},
        "errors": {c: {"before": before[c], "after": after[c], "floor": floor[c]} for c in after},
        "doubt": found.doubt,
        "converged": found.fit.converged,
        "method": found.method,
        "mean_square_over_noise": found.fit.square / found.fit.samples,
        "trials": [r.trial.file for r in found.problem.records],
        "audit": [x.told() for x in found.audit],
        "units": {name: CHANNELS[name].unit for name in CHANNELS},
        "input": source,
        "versions": versions(),
        "settings": found.experiment.model_dump(),
    }


def parameter_table(found: Identified) -> str:
    """What was identified, a line a parameter."""
    lines = []
    for i, p in enumerate(found.entries):
        lines.append(
            f"{p.label:<28} {parameter_text(parameter_record(found.fit, found.entries, i))}"
        )
        if i in found.advice:
            lines.append(f"{'':<28} {proposal_sentence(p, found.advice[i])}")
    before, after = (rms_errors(found.problem, y) for y in (found.before, found.fit.predicted))
    floor = noise_floors(found.problem, found.fit.predicted)
    lines += [
        f"{c:<28} rms {before[c]:.3g} before, {after[c]:.3g} after, floor {floor[c]:.3g} "
        f"{CHANNELS[c].unit}"
        for c in after
    ]
    lines += [found.doubt] if found.doubt else []
    return "\n".join(lines)


def identified_model(found: Identified) -> str:
    """The calibrated model, for `slider simulate --model`."""
    effects = list(dict.fromkeys(p.effect for p in found.entries if p.effect))
    said = f"Identified from {len(found.problem.records)} trials of {found.experiment.name}."
    said = f"{said} {found.doubt}".strip()
    return toml_text(model_tables(found.entries, found.fit.theta, effects), said)
