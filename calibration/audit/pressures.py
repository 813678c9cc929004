"""Do measured pressures answer the drive that the experiment declares? Trial by trial.

A trial is judged against the others: one lag, one delay and one gain serve all of them, and what is
wrong with all alike is physics, unless it is a unit, a sign or a pair of columns.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.audit.declared_drive import check_declared_drive, skewed
from calibration.audit.drive_response import (
    ANSWERS,
    NAMES,
    Answers,
    chambers_of,
    finding,
    pair,
    tiny,
    wrapped,
)
from calibration.audit.lag_response import drives
from calibration.measurements.findings import Finding
from calibration.measurements.records import Record
from slider_jax.channels import BUILT_IN

UNITS = {1e-3: "kPa", 1e3: "mPa", 1.0 / 6894.757: "psi", 1e-5: "bar", 1e-6: "MPa"}
"""Unit by what a pressure in it is of one in Pa."""
ALIKE = np.log(1.6)
"""How far a gain may lie from a unit's, as a logarithm; units are at least 6.9 apart."""


def check_pressures(
    records: Sequence[Record], rate: float | None
) -> tuple[list[Record], list[Finding]]:
    """Records mended where that is unambiguous, without those left out, and findings.

    `rate` [Hz] is the declared sample rate, or None.
    """
    plain = [r for r in records if drives(r.trial) is None]
    driven = [r for r in records if drives(r.trial) is not None]
    driven, findings = skewed(driven, rate)
    answers = Answers(driven, chambers_of(driven)) if driven else None
    for step in (_columns, _units, _front_and_rear, check_declared_drive):
        if answers is None:
            break
        driven, more = step(driven, answers)
        findings += more
        if more:
            answers = Answers(driven, chambers_of(driven)) if driven else None
    order = {r.trial.file: i for i, r in enumerate(records)}
    return sorted([*plain, *driven], key=lambda r: order[r.trial.file]), findings


def _columns(records: Sequence[Record], answers: Answers) -> tuple[list[Record], list[Finding]]:
    """Pressures that stand in another sensor's column."""
    kept, findings = [], []
    for i, r in enumerate(records):
        gain, left = answers.gain(i), answers.left(i)
        order = list(range(5))
        for c in (0, 1):
            strange = not 1e-6 < abs(gain[c, c]) < 1e5 or left[c, c] > ANSWERS
            fit = [
                x
                for x in range(2, len(gain))
                if left[x, c] < ANSWERS and 0.2 < abs(gain[x, c]) < 5.0
            ]
            ordinary = 0.2 < abs(gain[c, c]) < 5.0
            if fit and not ordinary and (strange or tiny(r, c)):
                other = min(fit, key=lambda x: left[x, c])
                order[c], order[other] = other, c
        if order == list(range(5)):
            kept.append(r)
            continue
        moved = [NAMES[x] for x in range(5) if order[x] != x]
        how = f"the columns {' and '.join(moved)} are swapped: each holds what the other should"
        findings.append(finding(r, "swapped_columns", ", ".join(moved), how, "mended"))
        kept.append(replace(r, values=r.values[order]))
    return kept, findings


def _units(records: Sequence[Record], answers: Answers) -> tuple[list[Record], list[Finding]]:
    """Pressures in other units, or with their sign turned."""
    normal = [
        abs(answers.gain(i)[c, c])
        for i in range(len(records))
        for c in (0, 1)
        if 0.2 < abs(answers.gain(i)[c, c]) < 5.0
    ]
    usual = float(np.median(normal)) if normal else 1.0
    kept, findings = [], []
    for i, r in enumerate(records):
        values = r.values.copy()
        for c in (0, 1):
            gain, left = answers.gain(i)[c, c], answers.left(i)[c, c]
            if left > ANSWERS or gain == 0.0:
                continue
            ratio = abs(gain) / usual
            unit = min(UNITS, key=lambda u: abs(np.log(ratio / u)))
            if abs(np.log(ratio / unit)) < ALIKE:
                how = (
                    f"{NAMES[c]} is {ratio:.4g} times what the drive makes: it is in "
                    f"{UNITS[unit]}, and was multiplied by {1.0 / unit:.6g}"
                )
                values[c] /= unit
                findings.append(finding(r, "units", BUILT_IN[c], how, "mended"))
            if gain < 0.0:
                how = f"{NAMES[c]} has the drive's sign turned; it was turned back"
                values[c] *= -1.0
                findings.append(finding(r, "sign", BUILT_IN[c], how, "mended"))
        kept.append(replace(r, values=values))
    return kept, findings


def _front_and_rear(
    records: Sequence[Record], answers: Answers
) -> tuple[list[Record], list[Finding]]:
    """Front and rear pressure in each other's column, from the rear's phase and amplitude."""
    both = [pair(r) for r in records]
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
        how = "p_front_Pa and p_rear_Pa are swapped: each follows the other chamber's drive"
        findings.append(finding(r, "swapped_columns", "p_front, p_rear", how, "mended"))
        kept.append(replace(r, values=r.values[[1, 0, 2, 3, 4]]))
    return kept, findings


def _swapped_by_phase(r: Record, found: tuple[float, float] | None) -> bool | None:
    """None where the phase declared does not tell the two apart."""
    if found is None:
        return None
    straight, crossed = (abs(wrapped(found[0] - s * r.trial.phase)) for s in (1.0, -1.0))
    if abs(wrapped(2.0 * r.trial.phase)) < 0.1:
        return None
    if crossed < 0.25 * straight:
        return True
    return False if straight < 0.25 * crossed else None


def _swapped_by_size(found: float, rear_ratio: float, others: Sequence[float]) -> bool:
    """Whether log front over rear is that of swapped columns, as the other trials have it."""
    if len(others) < 2:
        return False
    usual = float(np.median(others))
    spread = float(np.median(np.abs(np.array(others) - usual)))
    straight, crossed = usual - np.log(rear_ratio), np.log(rear_ratio) - usual
    apart = abs(straight - crossed)
    return apart > max(0.1, 8.0 * spread) and abs(found - crossed) < 0.25 * apart
