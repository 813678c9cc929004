"""Closes the loop on the rig's pressure logs."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from calibration.discrepancy.close_loop import LoopOutcome, conclude
from calibration.discrepancy.settings import DEFAULT_SETTINGS, SelectionSettings
from calibration.inference.cache import Memo
from calibration.inference.problem import AbstractProblem
from calibration.measurements.records import Record
from calibration.model.extended import base_values
from calibration.pressure_logs.audit import audit_logs
from calibration.pressure_logs.problem import (
    FREE,
    PressureLogProblem,
    log_candidates,
    log_experiment,
    log_record,
)
from calibration.pressure_logs.read import ManifoldLog
from slider_jax.errors import InputError


def close_loop_on_logs(
    logs: Sequence[ManifoldLog],
    effects: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda text: None,
    memo: Memo | None = None,
    settings: SelectionSettings = DEFAULT_SETTINGS,
) -> LoopOutcome:
    """Returns the effects that the pressure-lag model lacks on the rig's logs.

    In order of frequency, every second log is held out. Raises `InputError` if there are fewer than
    five logs.
    """
    least = 2 * settings.min_trials - 1
    if len(logs) < least:
        raise InputError(
            f"{len(logs)} logs given; tracing an effect needs {least} or more, at "
            "different frequencies: every other one is held out"
        )
    logs = sorted(logs, key=lambda log: log.frequency)
    names = tuple(log_candidates() if effects is None else effects)
    experiment = log_experiment(logs[0], None, {})
    found = [log_record(log, log_experiment(log, None, {})) for log in logs]

    def problem_of(chosen: Sequence[Record]) -> AbstractProblem:
        used = {id(r) for r in chosen}
        picked = [log for log, r in zip(logs, found, strict=True) if id(r) in used]
        return replace(PressureLogProblem.of_logs(picked, names), memo=memo)

    base = base_values(experiment)
    held = list(range(1, len(logs), 2))
    progress("auditing the logs")
    findings = audit_logs(logs)
    for finding in findings:
        progress(str(finding))
    outcome = conclude(experiment, names, found, held, problem_of, base, FREE, progress, settings)
    return replace(outcome, audit=findings)
