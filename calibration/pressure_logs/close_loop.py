"""Closes the loop on the rig's pressure logs, and simulates how added effects change the thrust."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome, conclude
from calibration.discrepancy.report import loop_record
from calibration.discrepancy.settings import SelectionSettings
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
    log_records,
)
from calibration.pressure_logs.read import PA_PER_PSI, ManifoldLog
from slider_jax.errors import InputError
from slider_jax.experiment.load import assemble
from slider_jax.io.files import input_file
from slider_jax.observables.strides import stride_means
from slider_jax.paper import PRESSURE_LAG
from slider_jax.simulation.effect_signature import FREQUENCY, built_in_experiment
from slider_jax.simulation.trial import simulate_trial

LOG_SETTINGS = SelectionSettings(complete_refits=True)
"""The pressure behind switching valves is far from linear in the parameters."""


def close_loop_on_logs(
    logs: Sequence[ManifoldLog],
    effects: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda text: None,
    memo: Memo | None = None,
) -> LoopOutcome:
    """Returns the loop's outcome: calibrated lag, effects that the lag model lacks, and verdict.

    `effects` are the names of the candidates (default: `log_candidates()`). Every second log, in
    the order of frequency, is held out. Raises `InputError` for too few logs.
    """
    least = 2 * LOG_SETTINGS.min_trials - 1
    if len(logs) < least:
        raise InputError(
            f"{len(logs)} logs given; the search for effects needs {least} or more logs at "
            "different frequencies, because every second log is held out; give more logs"
        )
    logs = sorted(logs, key=lambda log: log.frequency)
    names = tuple(log_candidates() if effects is None else effects)
    experiment = log_experiment(logs[0], None, {})
    halves = [log_records(log) for log in logs]

    def problem_of(chosen: Sequence[Record]) -> AbstractProblem:
        used = {id(r) for r in chosen}
        picked = [log for log, both in zip(logs, halves, strict=True) if id(both[0]) in used]
        return replace(PressureLogProblem.of_logs(picked, names), memo=memo)

    base = base_values(experiment)
    held = [i for i in range(2 * len(logs)) if i // 2 % 2 == 1]
    progress("auditing the logs")
    findings = audit_logs(logs)
    for finding in findings:
        progress(str(finding))
    outcome = conclude(
        experiment, names, sum(halves, []), held, problem_of, base, FREE, progress, LOG_SETTINGS
    )
    return replace(outcome, audit=findings)


def log_report(
    outcome: LoopOutcome, logs: Sequence[ManifoldLog], seconds: Callable[[], float]
) -> dict[str, Any]:
    """Returns the content of report.json. `seconds()` returns the time [s] since the loop began."""
    record = loop_record(outcome, 0.0, {"logs": [input_file(log.path) for log in logs]})
    record["errors_psi"] = {
        part: {c: {k: v / PA_PER_PSI for k, v in row.items()} for c, row in record[part].items()}
        for part in ("errors", "held_out")
    }
    record["consequence"] = thrust_change(outcome)
    record["seconds"] = seconds()
    return record


def thrust_change(outcome: LoopOutcome) -> dict[str, Any]:
    """Returns the built-in robot's thrust at `FREQUENCY` with three pressure models.

    The models are the paper's lag, the lag that fits the logs best, and the loop's final model.
    """
    k = [p.label for p in outcome.entries].index("k")
    pairs = list(zip(outcome.entries, outcome.final.theta, strict=True))
    effects = [
        {"name": name} | {p.name: float(x) for p, x in pairs if p.effect == name}
        for name in outcome.effects
    ]
    best, final = float(outcome.search.base.theta[k]), float(outcome.final.theta[k])
    trial = built_in_experiment().trials[0]
    return {
        "frequency_Hz": FREQUENCY,
        "waveform": trial.waveform,
        "amplitude_Pa": trial.amplitude,
        "robot": "built-in",
        "lag of the paper": built_in_last_stride({"k": PRESSURE_LAG}, []),
        "lag that fits the logs best": built_in_last_stride({"k": best}, []),
        "with the added effects": built_in_last_stride({"k": final}, effects),
    }


def built_in_last_stride(parameters: Mapping[str, float], effects: list[dict]) -> dict[str, float]:
    """Returns thrust, recoil, tip and pressure in the last stride of the built-in robot.

    The drive has the frequency `FREQUENCY`. `parameters` and `effects` of the pressure model are in
    the format of an experiment file. Raises `SolverError` if a step fails.
    """
    experiment = built_in_experiment()
    content = experiment.model_dump() | {"effects": effects}
    content["parameters"] = content["parameters"] | dict(parameters)
    run = simulate_trial(assemble(content, "built-in robot", experiment.folder))
    half = run.grid.half_period
    assert half is not None
    last = slice(len(run.t) - 2 * half, len(run.t))
    thrust = stride_means(jnp.asarray(run.series["thrust"][1:]), 2 * half)
    return {
        "mean_thrust_N": float(thrust[-1]),
        "recoil_rms_N": float(np.sqrt(np.mean(run.series["recoil"][last] ** 2))),
        "tip_half_range_m": 0.5 * float(np.ptp(run.series["tip"][last])),
        "pressure_half_range_Pa": 0.5 * float(np.ptp(run.series["p_front"][last])),
    }
