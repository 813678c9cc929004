"""Finds wrong columns, units, signs and settings of pressures by comparison with the drives.

The comparison uses one lag, one delay and one gain for all trials. A deviation that all trials
share counts as a fault only if it is a wrong unit, a wrong sign or a swap of columns.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.audit.chamber_order import check_chamber_order
from calibration.audit.declared_drive import check_clocks, check_declared_drive
from calibration.audit.drive_response import (
    MAX_RESIDUAL,
    DriveResponses,
    drives_of,
    is_tiny,
    sensor_rows,
    trial_finding,
)
from calibration.measurements.records import Finding, Record

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
    plain = [r for r in records if drives_of(r) is None]
    driven = [r for r in records if drives_of(r) is not None]
    driven, findings = check_clocks(driven, rate)
    responses = DriveResponses(driven) if driven else None
    for step in (_columns, _units, check_chamber_order, check_declared_drive):
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
        rows = sensor_rows(r.channels)
        order = list(rows)
        for c in responses.chambers:
            strange = not 1e-6 < abs(gain[c, c]) < 1e5 or residual[c, c] > MAX_RESIDUAL
            fit = [
                x
                for x in range(len(responses.chambers), len(gain))
                if residual[x, c] < MAX_RESIDUAL and 0.2 < abs(gain[x, c]) < 5.0
            ]
            ordinary = 0.2 < abs(gain[c, c]) < 5.0
            if fit and not ordinary and (strange or is_tiny(r, r.pressures[c])):
                other = min(fit, key=lambda x: residual[x, c])
                order[c], order[other] = rows[other], rows[c]
        if order == rows:
            kept.append(r)
            continue
        columns = [x.column for x in r.channels.values()]
        moved = [columns[x] for x, y in zip(rows, order, strict=True) if x != y]
        values = np.empty_like(r.values)
        values[rows] = r.values[order]
        detail = f"{' and '.join(moved)} are swapped: each column has another sensor's readings"
        findings.append(trial_finding(r, "swapped_columns", ", ".join(moved), detail, "mended"))
        kept.append(replace(r, values=values))
    return kept, findings


def _units(
    records: Sequence[Record], responses: DriveResponses
) -> tuple[list[Record], list[Finding]]:
    """Returns the records with all pressures in Pa and with the drive's sign, and findings."""
    gains = [abs(responses.gain(i)[c, c]) for i in range(len(records)) for c in responses.chambers]
    normal = [gain for gain in gains if 0.2 < gain < 5.0]
    usual = float(np.median(normal)) if normal else 1.0
    kept, findings = [], []
    for i, r in enumerate(records):
        values = r.values.copy()
        for c, name in enumerate(r.channels.pressures):
            row, column = r.row(name), r.channels[name].column
            gain, residual = responses.gain(i)[c, c], responses.residual(i)[c, c]
            if not residual <= MAX_RESIDUAL or gain == 0.0:
                continue
            ratio = abs(gain) / usual
            unit = min(UNITS, key=lambda u: abs(np.log(ratio / u)))
            if abs(np.log(ratio / unit)) < UNIT_MARGIN:
                detail = (
                    f"{column} is {ratio:.4g} times the expected response to the drive: the "
                    f"numbers are in {UNITS[unit]}, and were multiplied by {1.0 / unit:.6g}"
                )
                values[row] /= unit
                findings.append(trial_finding(r, "units", name, detail, "mended"))
            if gain < 0.0:
                detail = f"{column} has the opposite sign of the drive; the sign was inverted"
                values[row] *= -1.0
                findings.append(trial_finding(r, "sign", name, detail, "mended"))
        kept.append(replace(r, values=values))
    return kept, findings
