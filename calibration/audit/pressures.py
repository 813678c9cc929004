"""Finds wrong columns, units, signs and settings of pressures by comparison with the drives.

The comparison uses one lag, one delay and one gain for all trials. A deviation that all trials
share counts as a fault only if it is a wrong unit, a wrong sign or a swap of columns.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.audit.declared_drive import check_clocks, check_declared_drive
from calibration.audit.drive_response import (
    MAX_RESIDUAL,
    NAMES,
    DriveResponses,
    is_tiny,
    rear_lag_and_ratio,
    trial_finding,
    wrapped,
)
from calibration.audit.lag_response import declared_drives
from calibration.measurements.records import Finding, Record
from slider_jax.channels import BUILT_IN

UNITS = {1e-3: "kPa", 1e3: "mPa", 1.0 / 6894.757: "psi", 1e-5: "bar", 1e-6: "MPa"}
"""Names of wrong units. Each key is the value of 1 Pa in the unit."""
UNIT_MARGIN = np.log(1.6)
"""A unit is identified if |ln(gain/key)| is below this value. The keys of `UNITS` differ by a
factor of at least 6.9."""


def check_pressures(
    records: Sequence[Record], rate: float | None
) -> tuple[list[Record], list[Finding]]:
    """Returns the usable records with unambiguous faults repaired, and findings.

    `rate` [Hz] is the declared sample rate, or None.
    """
    plain = [r for r in records if declared_drives(r.trial) is None]
    driven = [r for r in records if declared_drives(r.trial) is not None]
    driven, findings = check_clocks(driven, rate)
    responses = DriveResponses(driven) if driven else None
    for step in (_columns, _units, _front_and_rear, check_declared_drive):
        if responses is None:
            break
        driven, more = step(driven, responses)
        findings += more
        if more:
            responses = DriveResponses(driven) if driven else None
    order = {r.trial.file: i for i, r in enumerate(records)}
    return sorted([*plain, *driven], key=lambda r: order[r.trial.file]), findings


def _columns(
    records: Sequence[Record], responses: DriveResponses
) -> tuple[list[Record], list[Finding]]:
    """Returns the records with pressures moved back from another sensor's column, and findings."""
    kept, findings = [], []
    for i, r in enumerate(records):
        gain, residual = responses.gain(i), responses.residual(i)
        order = list(range(len(r.values)))
        for c in (0, 1):
            strange = not 1e-6 < abs(gain[c, c]) < 1e5 or residual[c, c] > MAX_RESIDUAL
            fit = [
                x
                for x in range(2, len(gain))
                if residual[x, c] < MAX_RESIDUAL and 0.2 < abs(gain[x, c]) < 5.0
            ]
            ordinary = 0.2 < abs(gain[c, c]) < 5.0
            if fit and not ordinary and (strange or is_tiny(r, c)):
                other = min(fit, key=lambda x: residual[x, c])
                order[c], order[other] = other, c
        if order == sorted(order):
            kept.append(r)
            continue
        moved = [name for x, name in enumerate(NAMES) if order[x] != x]
        detail = f"{' and '.join(moved)} are swapped: each column has another sensor's readings"
        findings.append(trial_finding(r, "swapped_columns", ", ".join(moved), detail, "mended"))
        kept.append(replace(r, values=r.values[order]))
    return kept, findings


def _units(
    records: Sequence[Record], responses: DriveResponses
) -> tuple[list[Record], list[Finding]]:
    """Returns the records with all pressures in Pa and with the drive's sign, and findings."""
    gains = [abs(responses.gain(i)[c, c]) for i in range(len(records)) for c in (0, 1)]
    normal = [gain for gain in gains if 0.2 < gain < 5.0]
    usual = float(np.median(normal)) if normal else 1.0
    kept, findings = [], []
    for i, r in enumerate(records):
        values = r.values.copy()
        for c in (0, 1):
            gain, residual = responses.gain(i)[c, c], responses.residual(i)[c, c]
            if residual > MAX_RESIDUAL or gain == 0.0:
                continue
            ratio = abs(gain) / usual
            unit = min(UNITS, key=lambda u: abs(np.log(ratio / u)))
            if abs(np.log(ratio / unit)) < UNIT_MARGIN:
                detail = (
                    f"{NAMES[c]} is {ratio:.4g} times the expected response to the drive: the "
                    f"numbers are in {UNITS[unit]}, and were multiplied by {1.0 / unit:.6g}"
                )
                values[c] /= unit
                findings.append(trial_finding(r, "units", BUILT_IN[c], detail, "mended"))
            if gain < 0.0:
                detail = f"{NAMES[c]} has the opposite sign of the drive; the sign was inverted"
                values[c] *= -1.0
                findings.append(trial_finding(r, "sign", BUILT_IN[c], detail, "mended"))
        kept.append(replace(r, values=values))
    return kept, findings


def _front_and_rear(
    records: Sequence[Record], responses: DriveResponses
) -> tuple[list[Record], list[Finding]]:
    """Returns the records with front and rear pressure in their own columns, and findings.

    A swap is visible in the rear pressure's phase and amplitude relative to the front pressure.
    """
    both = [rear_lag_and_ratio(r) for r in records]
    swapped = [_swapped_by_phase(r, x) for r, x in zip(records, both, strict=True)]
    ratios = []
    for r, x, s in zip(records, both, swapped, strict=True):
        if x is not None and s is not None and r.trial.rear_ratio:
            ratios.append((-1.0 if s else 1.0) * np.log(x[1]) + np.log(abs(r.trial.rear_ratio)))
    kept, findings = [], []
    for r, x, s in zip(records, both, swapped, strict=True):
        if s is None and x is not None:
            s = _swapped_by_size(np.log(x[1]), abs(r.trial.rear_ratio), ratios)
        if not s:
            kept.append(r)
            continue
        detail = "p_front_Pa and p_rear_Pa are swapped: each fits the other chamber's drive"
        findings.append(trial_finding(r, "swapped_columns", "p_front, p_rear", detail, "mended"))
        kept.append(replace(r, values=np.concatenate([r.values[1::-1], r.values[2:]])))
    return kept, findings


def _swapped_by_phase(r: Record, found: tuple[float, float] | None) -> bool | None:
    """Returns whether the phase shows swapped columns; None if the phase is inconclusive."""
    if found is None or abs(wrapped(2.0 * r.trial.phase)) < 0.1:
        return None
    straight, crossed = (abs(wrapped(found[0] - s * r.trial.phase)) for s in (1.0, -1.0))
    if crossed < 0.25 * straight:
        return True
    return False if straight < 0.25 * crossed else None


def _swapped_by_size(found: float, rear_ratio: float, others: Sequence[float]) -> bool:
    """Returns whether `found`, ln(front/rear amplitude), shows that the columns are swapped.

    `others` contains, for each trial, the measured minus the declared ln(front/rear amplitude).
    """
    if len(others) < 2:
        return False
    usual = float(np.median(others))
    spread = float(np.median(np.abs(np.array(others) - usual)))
    straight, crossed = usual - np.log(rear_ratio), np.log(rear_ratio) - usual
    apart = abs(straight - crossed)
    return apart > max(0.1, 8.0 * spread) and abs(found - crossed) < 0.25 * apart
