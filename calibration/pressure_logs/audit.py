"""The audit of the rig's pressure logs: what the instrument does that no pneumatics can."""

from collections.abc import Sequence

import numpy as np

from calibration.audit.sensors import clipped, grain
from calibration.measurements.findings import Action, Finding, masked
from calibration.pressure_logs.code_density import CodeDensity, code_density
from calibration.pressure_logs.read import PSI_PER_COUNT, ManifoldLog

FULL_DUTY, DUTY_PER_COUNT = 250.0, 10.0
"""The firmware's law: duty = min(250, 10 |error in counts|), to one valve or the other."""
DUTY_OFF = 1.5
"""Rounding of the duty, in its unit."""
MOST_OFF = 0.01
"""Share of the samples that may break the law before it is told."""
MOST_JITTER = 1.0
"""Error of the sample times, in samples, before it is told."""


def audit_logs(logs: Sequence[ManifoldLog], seed: int = 0) -> list[Finding]:
    """What is wrong with the logs as an instrument wrote them, and with the sensor they share.

    Rows that were mended on reading, readings at the end of the converter's range, valve duties at
    odds with the firmware's law, sample times at odds with the command, and codes of unequal width.
    """
    findings = []
    for log in logs:
        name = log.path.name
        for row in log.findings:
            action: Action = "mended" if "dropped" in row.what else "used"
            findings.append(Finding(name, "log_row", None, None, None, str(row), action))
        findings += _clipped(log) + _duties(log) + _times(log)
    density = code_density([log.pressure for log in logs], seed)
    if density is not None and density.uneven:
        names = ", ".join(log.path.name for log in logs)
        findings.append(
            Finding(names, "code_density", "pressure", None, None, words(density), "used")
        )
    return findings


def words(found: CodeDensity) -> str:
    """The unevenness of the pressure codes in a sentence, in counts and psi."""
    rare = f"; {len(found.rare)} codes are rare" if found.rare else ""
    rare += f", {len(found.missing)} missing" if found.missing else ""
    return (
        "the pressure codes are not equally wide: their density waves by "
        f"{found.amplitude:.0%} with a period of {found.period:.1f} counts "
        f"({found.significance:.0f} standard deviations beyond smooth signals with the same "
        "noise), and the noise is high where the density is low (correlation "
        f"{found.opposed:.2f}){rare}. A width is off by up to {found.dnl:.2f} counts, a reading "
        f"by up to {found.inl:.1f} counts or {found.inl * PSI_PER_COUNT:.2f} psi: the converter, "
        "no pneumatics"
    )


def _clipped(log: ManifoldLog) -> list[Finding]:
    bad = clipped(log.pressure, grain(log.pressure, 0.0))
    if not bad.any():
        return []
    ends = " and ".join(f"{x:.0f}" for x in sorted(set(log.pressure[bad][[0, -1]])))
    said = f"the pressure is clipped near {ends} counts"
    return [masked(log.path.name, "clipped", "pressure", log.t, bad, said)]


def _duties(log: ManifoldLog) -> list[Finding]:
    """Valve duties that are not what the firmware makes of the error in the same row."""
    error = log.command - log.pressure
    law = np.minimum(FULL_DUTY, DUTY_PER_COUNT * np.abs(error))
    fill, vent = np.where(error > 0.0, law, 0.0), np.where(error > 0.0, 0.0, law)
    off = (np.abs(log.fill - fill) > DUTY_OFF) | (np.abs(log.vent - vent) > DUTY_OFF)
    if off.mean() <= MOST_OFF:
        return []
    first = float(log.t[np.argmax(off)])
    detail = (
        f"{off.mean():.1%} of the valve duties are not min(250, 10 |error|) of their own row, "
        f"first at {first:.3f} s: the columns are not of one instant, or the firmware is another"
    )
    return [Finding(log.path.name, "duty", "valves", first, None, detail, "used")]


def _times(log: ManifoldLog) -> list[Finding]:
    """Sample times against the command, which the firmware computes from its clock as a sine."""
    turn = 2.0 * np.pi * log.frequency * log.t
    columns = np.stack([np.cos(turn), np.sin(turn), np.ones_like(turn)], axis=1)
    a, b, c = np.linalg.lstsq(columns, log.command)[0]
    slope = 2.0 * np.pi * log.frequency * (b * np.cos(turn) - a * np.sin(turn))
    steep = np.abs(slope) > 0.7 * np.abs(slope).max()
    if not np.abs(slope).max() > 0.0:
        return []
    late = (log.command - columns @ np.array([a, b, c]))[steep] / slope[steep]
    worst = float(np.abs(late).max()) / log.period
    if worst <= MOST_JITTER:
        return []
    detail = (
        f"the command is up to {1e3 * worst * log.period:.1f} ms off the sine of the header at the "
        "times of its samples: samples were lost or late"
    )
    return [Finding(log.path.name, "clock", "t_s", None, None, detail, "used")]
