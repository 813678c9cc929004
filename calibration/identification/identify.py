"""Identifies the base parameters, and the parameters of given effects, from measured trials."""

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
from calibration.inference.goodness import channel_errors, excess
from calibration.inference.lbfgs import fit_lbfgs
from calibration.inference.problem import TankProblem
from calibration.inference.uncertainty import correlations, hausman_check
from calibration.measurements.records import Finding, Record
from calibration.model.extended import Parameter, base_values, base_vector, model_parameters
from calibration.model.plan import COARSE, FINE, Resolution
from calibration.reporting.parameters import model_tables, parameter_record, parameter_text
from slider_jax.channels import ChannelSet
from slider_jax.effects.library import LIBRARY
from slider_jax.errors import refuse_unknown
from slider_jax.experiment.load import Experiment
from slider_jax.io.files import provenance
from slider_jax.io.toml import toml_text

METHODS = {"lm": fit_gauss_newton, "lbfgs": fit_lbfgs}
LBFGS_PARAMETERS = 12
"""With this number of fitted parameters or more, the method "auto" is L-BFGS."""


class Identified(NamedTuple):
    """A fit of the base parameters and of the parameters of given effects."""

    experiment: Experiment
    entries: list[Parameter]
    problem: TankProblem
    before: list[np.ndarray]
    """Predicted readings (channels, samples) of every trial, before the fit."""
    fit: Fit
    method: str
    proposals: dict[int, Proposal]
    """Proposed trial for each parameter that the data do not determine, by index in `entries`."""
    audit: list[Finding]
    """Faults of the data and the actions taken."""
    doubt: str
    """Warning that a residual exceeds the noise floor, or an empty text."""


def check_names(
    effects: Sequence[str], channels: Sequence[str], method: str, known: ChannelSet
) -> None:
    """Raises `InputError` for a name that `identify_parameters` does not accept.

    `known` are the channels of the experiment.
    """
    refuse_unknown("--method", [method], ("auto", *METHODS))
    refuse_unknown("--also", effects, LIBRARY, "the names that slider effects lists")
    refuse_unknown("--channels", channels, known)


def identify_parameters(
    experiment: Experiment,
    effects: Sequence[str] = (),
    channels: Sequence[str] = (),
    progress: Callable[[str], None] = lambda text: None,
    fine: Resolution = FINE,
    coarse: Resolution = COARSE,
    method: str = "auto",
) -> Identified:
    """Fits C_d, m_a, k, K_Q and the parameters of `effects` to all measured trials.

    `channels` are the fitted channels (default: all). `method` is "lm" (Gauss-Newton), "lbfgs"
    (L-BFGS), or "auto" (see `LBFGS_PARAMETERS`). Raises `InputError` for an unknown effect, channel
    or method, or if no measured trial can be used.
    """
    check_names(effects, channels, method, experiment.channels)
    entries = model_parameters(tuple(effects))

    def problem_of(chosen: Sequence[Record]) -> TankProblem:
        names, fitted = tuple(effects), tuple(channels) or None
        return TankProblem.of(experiment, list(chosen), names, fitted, fine, coarse)

    base = base_vector(entries, base_values(experiment))
    initial = base.copy()
    for i, p in enumerate(entries):
        if (
            p.effect and not p.is_shape
        ):  # the null may be a bound, and a fit that starts at a bound stays there
            initial[i] += 0.02 * (p.prior.high - p.prior.low)
    progress("auditing the data")
    audited = audit_measurements(experiment, 1, lambda few: problem_of(few).predict(base))
    for finding in audited.findings:
        progress(str(finding))
    problem = problem_of(audited.records)
    before = problem.predict(base)
    if method == "auto":
        method = "lbfgs" if len(entries) >= LBFGS_PARAMETERS else "lm"
    strengths = np.flatnonzero([not p.is_shape for p in entries])
    best = METHODS[method](problem, entries, initial, strengths, progress)
    # A shape parameter has no influence while its effect is at the null, so the other parameters
    # are fitted first.
    if len(strengths) < len(entries):
        best = METHODS[method](problem, entries, best.theta, np.arange(len(entries)), progress)
    best = hausman_check(problem, entries, best)
    proposals = propose_trials(experiment, entries, problem, best, coarse, progress)
    found = experiment, entries, problem, before, best, method, proposals, audited.findings
    return Identified(*found, residual_warning(problem, best))


def residual_warning(problem: TankProblem, fit: Fit) -> str:
    """Returns a warning if the residual exceeds the noise floor, or else an empty text."""
    left = {
        c: x.all for c, x in excess(problem, fit).items() if x.all > DEFAULT_SETTINGS.noise_floor
    }
    if not left:
        return ""
    channels = ", ".join(f"{np.sqrt(x):.2g} times the noise in {c}" for c, x in left.items())
    return (
        f"The model does not explain these data: the residual is {channels}. The model lacks an "
        "effect, so the values are biased and the intervals are too narrow. Run slider close-loop "
        "to find the effect."
    )


def identification_record(found: Identified, source: dict[str, Any]) -> dict[str, Any]:
    """Returns the content of calibration.json."""
    labels = [p.label for p in found.entries]
    return {
        "parameters": {
            p.label: parameter_record(found.fit, found.entries, i)
            | (
                {"determined_by": proposal_record(found.proposals[i])}
                if i in found.proposals
                else {}
            )
            for i, p in enumerate(found.entries)
        },
        "correlations": {"order": labels, "matrix": correlations(found.fit)},
        "errors": channel_errors(found.problem, found.before, found.fit.predicted),
        "doubt": found.doubt,
        "converged": found.fit.converged,
        "method": found.method,
        "mean_square_over_noise": found.fit.square / found.fit.samples,
        "trials": [r.trial.file for r in found.problem.records],
        "audit": [x._asdict() for x in found.audit],
        "units": {name: x.unit for name, x in found.problem.all_channels.items()},
        "input": source,
        **provenance(),
        "settings": found.experiment.model_dump(),
    }


def parameter_table(found: Identified) -> str:
    """Returns the result as text, with one line for each parameter and for each channel."""
    labels = [p.label for p in found.entries]
    lines = entry_lines(found.fit, found.entries, labels, found.proposals)
    errors = channel_errors(found.problem, found.before, found.fit.predicted)
    channels = found.problem.all_channels
    lines += [
        f"{c:<28} rms {x['before']:.3g} before, {x['after']:.3g} after, noise floor "
        f"{x['floor']:.3g} {channels[c].unit}"
        for c, x in errors.items()
    ]
    lines += [found.doubt] if found.doubt else []
    return "\n".join(lines)


def entry_lines(
    fit: Fit, entries: Sequence[Parameter], labels: Sequence[str], proposals: dict[int, Proposal]
) -> list[str]:
    """Returns a line for each entry, followed by a line for the entry's proposed trial, if any."""
    lines = []
    for i, (p, label) in enumerate(zip(entries, labels, strict=True)):
        lines.append(f"{label:<28} {parameter_text(parameter_record(fit, entries, i))}")
        if i in proposals:
            lines.append(f"{'':<28} {proposal_sentence(p, proposals[i])}")
    return lines


def identified_model(found: Identified) -> str:
    """Returns the text of a model file with the fit, for `slider simulate --model`."""
    effects = list(dict.fromkeys(p.effect for p in found.entries if p.effect))
    comment = f"Identified from {len(found.problem.records)} trials of {found.experiment.name}."
    comment = f"{comment} {found.doubt}".strip()
    return toml_text(model_tables(found.entries, found.fit.theta, effects), comment)
