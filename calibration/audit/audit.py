"""Finds faults of instruments and files in measured trials, before any model is fitted.

The audit reads the rows, sorts the times, checks the sensors, and compares the pressures with the
drive. If a model's prediction is available, the audit also compares forces and tip with it. The
audit repairs unambiguous faults, masks (ignores) faulty readings, and excludes unusable trials.
Most checks compare a trial with the other trials. A deviation that all trials share is no fault,
because a missing effect of the model may cause this deviation.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.audit.drive_response import rows_of_body
from calibration.audit.prediction import check_predicted_channels
from calibration.audit.pressures import check_pressures
from calibration.audit.rows import Unusable, read_rows
from calibration.audit.sensors import check_sensor
from calibration.audit.time_stamps import regular_rows
from calibration.measurements.records import Finding, Record, declared_noise
from slider_jax.errors import InputError
from slider_jax.experiment.drive import pressure_limits
from slider_jax.experiment.load import Experiment

MAX_LISTED = 5
"""Largest number of findings that an error message lists."""


@dataclass(frozen=True)
class Audited:
    """The usable trials, and the findings on all trials."""

    records: list[Record]
    findings: list[Finding] = field(default_factory=list)


def audit_measurements(
    experiment: Experiment,
    least: int = 1,
    predict: Callable[[list[Record]], Sequence[np.ndarray]] | None = None,
) -> Audited:
    """Returns the usable trials of an experiment and the findings of the audit.

    `predict` returns, for each record, the readings (channels, n) that the starting model predicts.
    Without `predict`, the audit does not compare forces and tip with a prediction. Raises
    `InputError` with the findings if fewer than `least` trials are usable.
    """
    records, findings = _read(experiment)
    rate = None
    if "sensors" in experiment.model_fields_set:
        rate = experiment.sensors.sample_rate
    records, more = check_pressures(records, rate)
    findings += more
    records, more = _within_duration(records, rate)
    findings += more
    records, more = _without_copies(records)
    findings += more
    if predict is not None and len(records) >= least:
        records, more = check_predicted_channels(records, predict(records))
        findings += more
    order = {trial.file: i for i, trial in enumerate(experiment.trials)}
    findings.sort(key=lambda x: order[x.trial])
    if len(records) < least:
        raise InputError(_refusal(experiment, records, findings, least))
    return Audited(records, findings)


def _read(experiment: Experiment) -> tuple[list[Record], list[Finding]]:
    records: list[Record] = []
    findings: list[Finding] = []
    channels = experiment.channels
    for trial in experiment.trials:
        path = experiment.folder / trial.file
        if not path.exists():
            detail = "the file does not exist: the trial counts as not measured"
            findings.append(Finding(trial.file, "missing_file", None, None, None, detail, "used"))
            continue
        try:
            rows, more = read_rows(path, channels)
            findings += more
            rows, more = regular_rows(rows, trial)
            findings += more
        except Unusable as fault:
            findings.append(fault.finding)
            continue
        values, filled = rows.values.copy(), np.isfinite(rows.values).any(axis=0)
        for i, (channel, sensor) in enumerate(channels.items()):
            noise = declared_noise(experiment.sensors, sensor)
            found = check_sensor(trial.file, channel, rows.t, rows.values[i], noise, filled)
            values[i] = found[0]
            findings += found[1]
        records.append(Record(trial, rows.t, values, channels, pressure_limits(experiment)))
    return records, findings


def _within_duration(
    records: Sequence[Record], rate: float | None
) -> tuple[list[Record], list[Finding]]:
    """Returns the records without samples outside the trial's duration, and findings.

    A finding reports a trial whose sample rate differs from the declared `rate` [Hz] by over 5 %.
    """
    kept, findings = [], []
    for r in records:
        name, end = r.trial.file, r.trial.duration
        dt = float(np.median(np.diff(r.t)))
        if rate and abs(1.0 / dt - rate) > 0.05 * rate:
            detail = f"the sample rate is {1.0 / dt:.5g} Hz, but sensors.sample_rate is {rate:g} Hz"
            findings.append(Finding(name, "sample_rate", "t_s", None, None, detail, "used"))
        inside = (r.t >= -1e-9) & (r.t <= end * (1.0 + 1e-6))
        out = int(np.sum(~inside))
        if out > 2:
            span = float(r.t[~inside].min()), float(r.t[~inside].max())
            detail = f"{out} rows are outside the trial's time of 0 to {end:g} s and are not used"
            findings.append(Finding(name, "outside", "t_s", *span, detail, "masked"))
        if inside.sum() < 20:
            detail = f"fewer than 20 rows are within the trial's time of 0 to {end:g} s"
            findings.append(Finding(name, "outside", "t_s", None, None, detail, "left out"))
            continue
        times = np.maximum(r.t[inside], 0.0)
        kept.append(r if not out else replace(r, t=times, values=r.values[:, inside]))
    return kept, findings


def _without_copies(records: Sequence[Record]) -> tuple[list[Record], list[Finding]]:
    """Returns the records whose forces and tip are not copies of an earlier trial, and findings."""
    kept: list[Record] = []
    findings = []
    for r in records:
        original = next((k for k in kept if _same(k, r)), None)
        if original is None:
            kept.append(r)
            continue
        detail = f"forces and tip have the same readings as in {original.trial.file}"
        findings.append(Finding(r.trial.file, "copied", None, None, None, detail, "left out"))
    return kept, findings


def _same(a: Record, b: Record) -> bool:
    n, rows = min(len(a.t), len(b.t)), rows_of_body(a.channels)
    first, second = a.values[rows, :n], b.values[rows, :n]
    there = np.isfinite(first) & np.isfinite(second)
    return bool(
        there.sum() > 20 and np.ptp(first[there]) > 0.0
        and np.mean(first[there] == second[there]) > 0.99
    )  # fmt: skip


def _refusal(
    experiment: Experiment, records: Sequence[Record], findings: Sequence[Finding], least: int
) -> str:
    bad = [x for x in findings if x.action == "left out"]
    missing = [x.trial for x in findings if x.kind == "missing_file"]
    text = "; ".join(f"{x.trial}: {x.detail}" for x in bad[:MAX_LISTED])
    more = f"; and {len(bad) - MAX_LISTED} more faults" if len(bad) > MAX_LISTED else ""
    rest = f" and {len(missing) - MAX_LISTED} more" if len(missing) > MAX_LISTED else ""
    absent = f"; no such file: {', '.join(missing[:MAX_LISTED])}{rest}" if missing else ""
    return (
        f"{experiment.folder}: {len(records)} measured trials are usable, but at least {least} are "
        f"needed{'; ' if text else ''}{text}{more}{absent}; repair, repeat or add trials"
    )
