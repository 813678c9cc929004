"""Reports trials whose clock, frequency, phase, amplitude or start is not as declared."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.audit.drive_response import (
    MAX_RESIDUAL,
    DriveResponses,
    chamber_tones,
    driven_chambers,
    driven_in,
    drives_of,
    trial_finding,
    wrapped,
)
from calibration.audit.lag_response import (
    DELAYS,
    TIME_CONSTANTS,
    PeriodRatio,
    fit_lags,
    leave_one_out,
    period_ratio,
)
from calibration.measurements.records import Finding, Record

SKEW = 0.004
"""A smaller relative frequency error is no fault, because slow transients may cause it."""
MAX_SKEW = 0.03
"""Largest relative frequency error of a skewed clock. A larger error counts as a wrong drive."""
WRONG_DRIVE = 0.8
"""A drive is wrong if a pressure's relative residual exceeds this value at every lag and delay."""
STRANGE, TIMES = 0.25, 6.0
"""A drive is also wrong if the residual exceeds both `STRANGE` and `TIMES` times the median of all
trials."""
WRONG_AMPLITUDE = np.log(1.25)
FITS = 0.1
"""A trial's delay is checked only if the relative residual of its pressures is below this value."""
LATE = 0.02
"""Largest accepted difference of a trial's delay from the delay of the other trials [s]."""
WRONG_PHASE = 0.05
"""Largest accepted difference of a chamber's phase from the declared phase [periods]."""


def check_clocks(
    records: Sequence[Record], rate: float | None
) -> tuple[list[Record], list[Finding]]:
    """Returns the usable records with corrected clocks, and findings.

    The pressures' frequency reveals the clock's error. `rate` [Hz] is the declared sample rate.
    """
    clocks = [_clock(r) for r in records]
    known = [p.off for p in clocks if p is not None]
    kept, findings = [], []
    for r, p in zip(records, clocks, strict=True):
        if p is None or abs(p.off) < max(SKEW, 5.0 * p.error):
            kept.append(r)
            continue
        alike = sum(abs(x - p.off) < 0.1 * abs(p.off) + 1e-3 for x in known)
        ticks = 1.0 / (rate * float(np.median(np.diff(r.t)))) - 1.0 if rate else np.nan
        text = (
            f"the pressures' frequency is {abs(p.off):.2%} {'above' if p.off > 0 else 'below'} "
            f"the declared {r.trial.frequency:g} Hz"
        )
        both = abs(ticks - p.off) < 0.1 * abs(p.off) + 1e-3
        if both or (alike > 2 and alike > 0.7 * len(known)):
            why = "the sample rate has the same error" if both else "other trials have this error"
            detail = f"{text}, and {why}: the clock is skewed; the times were rescaled"
            scale = 1.0 + (ticks if both else float(np.median(known)))
            kept.append(replace(r, t=r.t * scale))
            findings.append(trial_finding(r, "clock_skew", "t_s", detail, "mended"))
        elif abs(p.off) < MAX_SKEW:
            detail = f"{text}: the clock is skewed, or the drive had another frequency"
            findings.append(trial_finding(r, "clock_skew", "t_s", detail, "left out"))
        else:
            detail = f"{text}: the drive had another frequency{_partner(records, r)}"
            findings.append(trial_finding(r, "wrong_drive", all_pressures(r), detail, "left out"))
    return kept, findings


def _clock(r: Record) -> PeriodRatio | None:
    """Returns the relative error of the pressures' frequency; None if the pressures disagree."""
    assert r.trial.frequency is not None
    drives = drives_of(r)
    assert drives is not None
    found = []
    for p in r.pressures[driven_in(drives)]:
        there = np.isfinite(p)
        if there.mean() > 0.5:
            found.append(period_ratio(r.t[there], p[there], r.trial.frequency))
    known = [x for x in found if x is not None]
    if not known or len(known) < len(found):
        return None
    off, error = float(np.mean([x.off for x in known])), max(x.error for x in known)
    agree = np.ptp([x.off for x in known]) < 1e-3 + 0.15 * abs(off)
    return PeriodRatio(off, error) if agree else None


def check_declared_drive(
    records: Sequence[Record], responses: DriveResponses
) -> tuple[list[Record], list[Finding]]:
    """Returns the trials that were driven as declared, and findings on the other trials."""
    least = np.array([responses.least_residual(i) for i in range(len(records))])
    usual = float(np.nanmedian(least))
    wrong = _late(records, responses, range(len(records)))
    limit = min(max(WRONG_DRIVE, 2.0 * usual), max(STRANGE, TIMES * usual))
    for i, r in enumerate(records):
        there = np.isfinite(r.pressures).mean(axis=1)
        bad = [c for c in responses.chambers if there[c] > 0.3 and least[i, c] > limit]
        if bad and i not in wrong:
            names = [r.channels.pressures[c] for c in bad]
            columns = " and ".join(r.channels[x].column for x in names)
            detail = (
                f"the declared drive ({r.trial.frequency:g} Hz) does not explain "
                f"{columns} in this trial{_partner(records, r)}"
            )
            wrong[i] = trial_finding(r, "wrong_drive", ", ".join(names), detail, "left out")
    good = [i for i in range(len(records)) if i not in wrong]
    for check in (_wrong_phase, _wrong_amplitude):
        for i, found in check([records[i] for i in good], responses, good).items():
            wrong.setdefault(i, found)
    kept = [r for i, r in enumerate(records) if i not in wrong]
    return kept, [wrong[i] for i in sorted(wrong)]


def all_pressures(r: Record) -> str:
    """Returns the names of a record's pressures."""
    return ", ".join(r.channels.pressures)


def _partner(records: Sequence[Record], r: Record) -> str:
    """Returns a text that names the trial whose drive the pressures of `r` follow, or ''."""
    for other in records:
        chambers = drives_of(other)
        if other is r or chambers is None:
            continue
        residual = fit_lags(r.t, r.pressures, chambers).residual
        if max(residual[c, c].min() for c in driven_in(chambers)) < 0.5 * STRANGE:
            return f"; the pressures fit the drive of {other.trial.file}: the files may be swapped"
    return ""


def _late(
    records: Sequence[Record], responses: DriveResponses, index: Sequence[int]
) -> dict[int, Finding]:
    """Returns findings on trials whose pressures have another delay than in the other trials."""
    if len(records) < 4:
        return {}
    around = DELAYS[responses.at[1]] + np.arange(-0.2, 0.2, 0.005)
    lag = TIME_CONSTANTS[[responses.at[0]]]
    delays, least = [], []
    for r, chambers in zip(records, driven_chambers(records), strict=True):
        fits, own = fit_lags(r.t, r.pressures, chambers, around, lag), driven_in(chambers)
        together = np.sqrt(np.mean(fits.residual[own, own, 0] ** 2, axis=0))
        delays.append(around[together.argmin()])
        least.append(float(together.min()))
    x = np.log([[r.trial.frequency or 1.0] for r in records])
    late = leave_one_out(np.array(delays), x - x.mean(axis=0), np.full(1, 0.02), 2.5e-3)
    found = {}
    for j, r in enumerate(records):
        off, error = late[j]
        if abs(off) > max(LATE, 8.0 * error) and least[j] < max(FITS, 1.5 * np.median(least)):
            detail = (
                f"the delay of the pressures is {1e3 * abs(off):.0f} ms "
                f"{'longer' if off > 0 else 'shorter'} than in the other trials: the times are "
                "offset"
            )
            found[index[j]] = trial_finding(r, "time_offset", "t_s", detail, "left out")
    return found


def _wrong_phase(
    records: Sequence[Record], responses: DriveResponses, index: Sequence[int]
) -> dict[int, Finding]:
    """Returns findings on trials in which a chamber has another phase than declared.

    Phases are relative to the first chamber that is driven in the trial. The other trials are those
    in which the same chambers are driven. The chamber with the largest difference is named.
    """
    drives = driven_chambers(records)
    lags = np.full((len(records), len(responses.chambers)), np.nan)
    for j, r in enumerate(records):
        tones = chamber_tones(r)
        if tones is not None:
            lags[j] = tones.lag - np.array([x.lag for x in drives[j]])
    frequencies = np.array([r.trial.frequency or 1.0 for r in records])
    found = {}
    for j, r in enumerate(records):
        own, f = driven_in(drives[j]), frequencies[j]
        off = wrapped(lags[:, own] - lags[:, own[:1]]) / frequencies[:, None]
        rest = np.delete(off, j, axis=0)
        rest = rest[np.isfinite(rest).all(axis=1)]
        if not np.isfinite(off[j]).all() or len(rest) < 2:
            continue
        usual = np.median(rest, axis=0)
        spread = np.median(np.abs(rest - usual), axis=0)
        phase = wrapped((off[j] - usual) * f)
        wrong = np.abs(phase) > np.maximum(WRONG_PHASE, 8.0 * spread * f)
        if wrong.any():
            worst = int(np.argmax(np.where(wrong, np.abs(phase), 0.0)))
            first, name = (r.channels.pressures[own[i]] for i in (0, worst))
            should = drives[j][own[worst]].phase - drives[j][own[0]].phase
            detail = (
                f"the {r.channels[name].label} lags the {r.channels[first].label} by "
                f"{wrapped(should + phase[worst]):.2f} of a period, but the declared phase is "
                f"{should:g}"
            )
            found[index[j]] = trial_finding(r, "wrong_phase", name, detail, "left out")
    return found


def _wrong_amplitude(
    records: Sequence[Record], responses: DriveResponses, index: Sequence[int]
) -> dict[int, Finding]:
    """Returns findings on trials in which all pressures have another amplitude than declared."""
    if len(records) < 5:
        return {}
    own = [driven_in(x) for x in driven_chambers(records)]
    gain = [np.diagonal(responses.gain(i))[c] for i, c in zip(index, own, strict=True)]
    residual = [np.diagonal(responses.residual(i))[c] for i, c in zip(index, own, strict=True)]
    fit = [
        j
        for j, (g, x) in enumerate(zip(gain, residual, strict=True))
        if (g > 0.0).all() and (x < MAX_RESIDUAL).all()
    ]
    if len(fit) < 5:
        return {}
    # Gains of different chambers may differ, and a trial need not drive all chambers.
    each = np.full((len(fit), len(responses.chambers)), np.nan)
    for row, j in zip(each, fit, strict=True):
        row[own[j]] = np.log(gain[j])
    driven = np.isfinite(each).any(axis=0)
    size = np.nanmean(each[:, driven] - np.nanmedian(each[:, driven], axis=0), axis=1)
    trials = [records[j].trial for j in fit]
    x = np.log([[t.frequency or 1.0, t.amplitude or 1.0] for t in trials])
    deviations = leave_one_out(size, x - x.mean(axis=0), np.full(2, 0.3), 0.01)
    found = {}
    for j, (off, error) in zip(fit, deviations, strict=True):
        alike = np.ptp(np.log(gain[j])) < 0.5 * abs(off)
        if abs(off) > max(WRONG_AMPLITUDE, 8.0 * error) and alike:
            r = records[j]
            which = "the pressure" if len(own[j]) == 1 else "the pressures"
            detail = (
                f"the ratio of {which} to the declared amplitude, {r.trial.amplitude:g} Pa, "
                f"is {np.exp(off):.2f} times the ratio in the other trials"
            )
            channels = all_pressures(r)
            found[index[j]] = trial_finding(r, "wrong_amplitude", channels, detail, "left out")
    return found
