"""Trials that were not run as declared: clock, frequency, phase, amplitude, start."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.audit.drive_response import (
    ANSWERS,
    NAMES,
    Answers,
    chambers_of,
    finding,
    pair,
    wrapped,
)
from calibration.audit.lag_response import (
    DELAYS,
    TIME_CONSTANTS,
    PeriodRatio,
    drives,
    fits,
    pace,
    surprise,
)
from calibration.measurements.findings import Finding
from calibration.measurements.records import Record
from slider_jax.channels import BUILT_IN

SKEW = 0.004
"""Clocks that differ by less are not told from slow transients."""
MOST_SKEW = 0.03
"""No clock is off by more; a drive that was not the one declared is."""
WRONG_DRIVE = 0.8
"""A pressure that leaves so much at every lag and delay does not follow the drive declared,"""
STRANGE, TIMES = 0.25, 6.0
"""nor does one that leaves as much as this and as many times the other trials' median."""
WRONG_AMPLITUDE = np.log(1.25)
FITS = 0.1
"""Share left up to which a pressure's delay can be told."""
LATE = 0.02
"""Seconds by which a trial's times may be off those of the others."""
OFF_PHASE = 0.05
"""Of a period, by which the rear chamber may be off the phase declared."""


def skewed(records: Sequence[Record], rate: float | None) -> tuple[list[Record], list[Finding]]:
    """Clocks that run fast or slow, from the pace of the pressures."""
    offs = [_clock(r) for r in records]
    told = [p.off for p in offs if p is not None]
    kept, findings = [], []
    for r, p in zip(records, offs, strict=True):
        if p is None or abs(p.off) < max(SKEW, 5.0 * p.error):
            kept.append(r)
            continue
        alike = sum(abs(x - p.off) < 0.1 * abs(p.off) + 1e-3 for x in told)
        ticks = 1.0 / (rate * float(np.median(np.diff(r.t)))) - 1.0 if rate else np.nan
        said = (
            f"the pressures repeat {abs(p.off):.2%} {'faster' if p.off > 0 else 'slower'} than "
            f"{r.trial.frequency:g} Hz"
        )
        both = abs(ticks - p.off) < 0.1 * abs(p.off) + 1e-3
        if both or (alike > 2 and alike > 0.7 * len(told)):
            why = "the sample rate is off by as much" if both else "so they do in the other trials"
            how = f"{said}, and {why}: the clock is skewed; the times were rescaled"
            scale = 1.0 + (ticks if both else float(np.median(told)))
            kept.append(replace(r, t=r.t * scale))
            findings.append(finding(r, "clock_skew", "t_s", how, "mended"))
        elif abs(p.off) < MOST_SKEW:
            how = f"{said}: its clock is skewed, or another frequency was run than declared"
            findings.append(finding(r, "clock_skew", "t_s", how, "left out"))
        else:
            how = f"{said}: another frequency was run than declared{_partner(records, r)}"
            findings.append(finding(r, "wrong_drive", "p_front, p_rear", how, "left out"))
    return kept, findings


def _clock(r: Record) -> PeriodRatio | None:
    """The pace that both pressures agree on."""
    assert r.trial.frequency is not None
    found = []
    for row in (0, 1):
        there = np.isfinite(r.values[row])
        if there.mean() > 0.5:
            found.append(pace(r.t[there], r.values[row, there], r.trial.frequency))
    known = [p for p in found if p is not None]
    if len(known) < 2:
        return known[0] if known and not len(found) > 1 else None
    front, rear = known
    off, error = 0.5 * (front.off + rear.off), max(front.error, rear.error)
    agree = abs(front.off - rear.off) < 1e-3 + 0.15 * abs(off)
    return PeriodRatio(off, error) if agree else None


def check_declared_drive(
    records: Sequence[Record], answers: Answers
) -> tuple[list[Record], list[Finding]]:
    """Trials whose pressures are those of another drive, or of another time, than declared."""
    own = np.array([answers.own(i) for i in range(len(records))])
    usual = float(np.median(own))
    wrong = _late(records, answers, range(len(records)))
    for i, r in enumerate(records):
        bad = [c for c in (0, 1) if np.isfinite(r.values[c]).mean() > 0.3]
        bad = [
            c
            for c in bad
            if own[i, c] > max(WRONG_DRIVE, 2.0 * usual) or own[i, c] > max(STRANGE, TIMES * usual)
        ]
        if bad and i not in wrong:
            wrong[i] = _another_drive(records, i, bad)
    good = [i for i in range(len(records)) if i not in wrong]
    for check_ in (_off_phase, _amplitude):
        for i, found in check_([records[i] for i in good], answers, good).items():
            wrong.setdefault(i, found)
    kept = [r for i, r in enumerate(records) if i not in wrong]
    return kept, [wrong[i] for i in sorted(wrong)]


def _another_drive(records: Sequence[Record], i: int, bad: Sequence[int]) -> Finding:
    r, names = records[i], " and ".join(NAMES[c] for c in bad)
    how = (
        f"{names} cannot be the answer to the drive declared ({r.trial.frequency:g} Hz), as those "
        f"of the other trials are{_partner(records, r)}"
    )
    return finding(r, "wrong_drive", ", ".join(BUILT_IN[c] for c in bad), how, "left out")


def _partner(records: Sequence[Record], r: Record) -> str:
    """Words on the trial whose declared drive the pressures of `r` follow, if there is one."""
    for other in records:
        chambers = drives(other.trial)
        if other is r or chambers is None:
            continue
        left = fits(r.t, r.values[:2], chambers).left
        if max(left[c, c].min() for c in (0, 1)) < 0.5 * STRANGE:
            return f"; they follow that of {other.trial.file}: the files may be exchanged"
    return ""


def _late(records: Sequence[Record], answers: Answers, index: Sequence[int]) -> dict[int, Finding]:
    """Times that are off those of the other trials, where the answers fit well enough to tell."""
    if len(records) < 4:
        return {}
    around = DELAYS[answers.at[1]] + np.arange(-0.2, 0.2, 0.005)
    lag = TIME_CONSTANTS[[answers.at[0]]]
    delays, least = [], []
    for r, chambers in zip(records, chambers_of(records), strict=True):
        left = fits(r.t, r.values[:2], chambers, around, lag).left[[0, 1], [0, 1], 0]
        together = np.sqrt(np.mean(left**2, axis=0))
        delays.append(around[together.argmin()])
        least.append(float(together.min()))
    x = np.log([[r.trial.frequency or 1.0] for r in records])
    told = surprise(np.array(delays), x - x.mean(axis=0), np.full(1, 0.02), 2.5e-3)
    found = {}
    for j, r in enumerate(records):
        off, error = told[j]
        if abs(off) > max(LATE, 8.0 * error) and least[j] < max(FITS, 1.5 * np.median(least)):
            how = (
                f"the pressures come {1e3 * abs(off):.0f} ms {'later' if off > 0 else 'earlier'} "
                "after the drive than in the other trials: its times are offset"
            )
            found[index[j]] = finding(r, "time_offset", "t_s", how, "left out")
    return found


def _off_phase(
    records: Sequence[Record], answers: Answers, index: Sequence[int]
) -> dict[int, Finding]:
    """Rear chambers that ran at another phase than declared."""
    pairs = [pair(r) for r in records]
    off = np.array(
        [
            np.nan if p is None else wrapped(p[0] - r.trial.phase) / (r.trial.frequency or 1.0)
            for r, p in zip(records, pairs, strict=True)
        ]
    )
    found = {}
    for j, r in enumerate(records):
        rest = np.delete(off, j)
        rest = rest[np.isfinite(rest)]
        if not np.isfinite(off[j]) or len(rest) < 2 or not r.trial.frequency:
            continue
        usual = float(np.median(rest))
        spread = float(np.median(np.abs(rest - usual)))
        turns = wrapped((off[j] - usual) * r.trial.frequency)
        if abs(turns) > max(OFF_PHASE, 8.0 * spread * r.trial.frequency):
            how = (
                f"the rear pressure follows the front by {wrapped(r.trial.phase + turns):.2f} of "
                f"a period; declared is {r.trial.phase:g}"
            )
            found[index[j]] = finding(r, "wrong_phase", "p_rear", how, "left out")
    return found


def _amplitude(
    records: Sequence[Record], answers: Answers, index: Sequence[int]
) -> dict[int, Finding]:
    """Drives of another amplitude than declared, both chambers alike."""
    if len(records) < 5:
        return {}
    pair = np.array([[answers.gain(i)[c, c] for c in (0, 1)] for i in index])
    left = np.array([max(answers.left(i)[c, c] for c in (0, 1)) for i in index])
    whole = [j for j in range(len(index)) if (pair[j] > 0.0).all() and left[j] < ANSWERS]
    if len(whole) < 5:
        return {}
    size = np.log(pair[whole]).mean(axis=1)
    trials = [records[j].trial for j in whole]
    x = np.log([[t.frequency or 1.0, t.amplitude or 1.0] for t in trials])
    found = {}
    for j, s in zip(whole, surprise(size, x - x.mean(axis=0), np.full(2, 0.3), 0.01), strict=True):
        alike = abs(float(np.log(pair[j, 0] / pair[j, 1]))) < 0.5 * abs(s.apart)
        if abs(s.apart) > max(WRONG_AMPLITUDE, 8.0 * s.error) and alike:
            r = records[j]
            how = (
                f"both pressures are {np.exp(s.apart):.2f} times what the other trials make of the "
                f"amplitude declared, {r.trial.amplitude:g} Pa"
            )
            found[index[j]] = finding(r, "wrong_amplitude", "p_front, p_rear", how, "left out")
    return found
