"""The audit of measured trials: instrument causes before physics.

Files are read row by row, times put in order, sensors checked for what no physics does, pressures
held against the drive and, where a prediction is at hand, forces and tip against it. What can be
put right without a doubt is; a trial that cannot is left out; the others are used. Every step is
judged against the other trials, so that what all of them share, a missing effect, is no fault.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.audit import pressures as audit_drive, sensors as audit_sensors
from calibration.audit.prediction import against_model
from calibration.audit.rows import Unusable, read_rows
from calibration.audit.time_stamps import regular_rows
from calibration.measurements.findings import Finding, left_out
from calibration.measurements.records import Record
from slider_jax.channels import CHANNELS
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.schema import SensorsTable

MOST_SAID = 5
"""Findings that an error message lists."""


@dataclass(frozen=True)
class Audited:
    """The trials that can be used, and everything that was found."""

    records: list[Record]
    findings: list[Finding] = field(default_factory=list)


def audit_measurements(
    experiment: Experiment,
    least: int = 1,
    predict: Callable[[list[Record]], Sequence[np.ndarray]] | None = None,
) -> Audited:
    """Audit the measured trials of an experiment.

    `predict` gives readings (5, n) of records by the starting model; without it forces and tip are
    checked for themselves only. Raises `InputError`, listing the findings, where fewer than `least`
    trials are left.
    """
    records, findings = _read(experiment)
    rate = None
    if "sensors" in experiment.model_fields_set:
        rate = experiment.sensors.sample_rate
    records, more = audit_drive.check_pressures(records, rate)
    findings += more
    records, more = _extents(records, rate)
    findings += more
    records, more = _same_twice(records)
    findings += more
    if predict is not None and len(records) >= least:
        records, more = against_model(records, predict(records))
        findings += more
    order = {trial.file: i for i, trial in enumerate(experiment.trials)}
    findings.sort(key=lambda x: order[x.trial])
    if len(records) < least:
        raise InputError(_refusal(experiment, records, findings, least))
    return Audited(records, findings)


def _read(experiment: Experiment) -> tuple[list[Record], list[Finding]]:
    records: list[Record] = []
    findings: list[Finding] = []
    for trial in experiment.trials:
        path = experiment.folder / trial.file
        if not path.exists():
            detail = "the file is not there: the trial counts as not measured"
            findings.append(Finding(trial.file, "missing_file", None, None, None, detail, "used"))
            continue
        try:
            rows, more = read_rows(path)
            findings += more
            rows, more = regular_rows(rows, trial)
            findings += more
        except Unusable as fault:
            findings.append(fault.finding)
            continue
        values, filled = rows.values.copy(), np.isfinite(rows.values).any(axis=0)
        for i, channel in enumerate(CHANNELS):
            noise = declared_noise(experiment.sensors, channel)
            values[i], more = audit_sensors.check_sensor(
                trial.file, channel, rows.t, rows.values[i], noise, filled
            )
            findings += more
        records.append(Record(trial, rows.t, values))
    return records, findings


def declared_noise(sensors: SensorsTable, channel: str) -> float:
    """One standard deviation of the white noise that is declared, 0 where none is."""
    key = CHANNELS[channel].noise
    return getattr(sensors, key) if key else 0.0


def _extents(records: Sequence[Record], rate: float | None) -> tuple[list[Record], list[Finding]]:
    """Without samples before the start and after the end; sample rates are compared."""
    kept, findings = [], []
    for r in records:
        name, end = r.trial.file, r.trial.duration
        dt = float(np.median(np.diff(r.t)))
        if rate and abs(1.0 / dt - rate) > 0.05 * rate:
            detail = f"rows come at {1.0 / dt:.5g} Hz; sensors.sample_rate says {rate:g} Hz"
            findings.append(Finding(name, "sample_rate", "t_s", None, None, detail, "used"))
        inside = (r.t >= -1e-9) & (r.t <= end * (1.0 + 1e-6))
        out = int(np.sum(~inside))
        if out > 2:
            span = float(r.t[~inside].min()), float(r.t[~inside].max())
            detail = f"{out} rows lie outside the trial's 0 to {end:g} s and are not used"
            findings.append(Finding(name, "outside", "t_s", *span, detail, "masked"))
        if inside.sum() < 20:
            detail = f"fewer than 20 rows lie within the trial's 0 to {end:g} s"
            findings.append(Finding(name, "outside", "t_s", None, None, detail, "left out"))
            continue
        times = np.maximum(r.t[inside], 0.0)
        kept.append(r if not out else replace(r, t=times, values=r.values[:, inside]))
    return kept, findings


def _same_twice(records: Sequence[Record]) -> tuple[list[Record], list[Finding]]:
    """Without trials whose file is a copy of another's."""
    kept: list[Record] = []
    findings = []
    for r in records:
        twin = next((k for k in kept if _same(k.values, r.values)), None)
        if twin is None:
            kept.append(r)
            continue
        detail = f"the file holds the readings of {twin.trial.file} once more"
        findings.append(Finding(r.trial.file, "copied", None, None, None, detail, "left out"))
    return kept, findings


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    n = min(a.shape[1], b.shape[1])
    first, second = a[2:, :n], b[2:, :n]
    there = np.isfinite(first) & np.isfinite(second)
    return bool(
        there.sum() > 20 and np.ptp(first[there]) > 0.0
        and np.mean(first[there] == second[there]) > 0.99
    )  # fmt: skip


def _refusal(
    experiment: Experiment, records: Sequence[Record], findings: Sequence[Finding], least: int
) -> str:
    out = left_out(findings)
    bad = [x for x in findings if x.trial in out and x.action == "left out"]
    missing = sum(x.kind == "missing_file" for x in findings)
    said = "; ".join(f"{x.trial}: {x.detail}" for x in bad[:MOST_SAID])
    more = f"; and {len(bad) - MOST_SAID} more" if len(bad) > MOST_SAID else ""
    absent = f"; {missing} files are not there" if missing else ""
    return (
        f"{experiment.folder}: holds {len(records)} measured trials that can be used; {least} or "
        f"more are needed{'; ' if said else ''}{said}{more}{absent}; mend or repeat these trials"
    )
