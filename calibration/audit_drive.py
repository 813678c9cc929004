"""Do measured pressures answer the drive that the experiment declares? Trial by trial.

A trial is judged against the others: one lag, one delay and one gain serve all of them, and what is
wrong with all alike is physics, unless it is a unit, a sign or a pair of columns.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.audit_signal import (
    DELAYS,
    TIME_CONSTANTS,
    Drive,
    Fits,
    Pace,
    drives,
    fits,
    pace,
    surprise,
    tone,
)
from calibration.findings import Finding
from calibration.forward import CHANNELS
from calibration.measured import COLUMNS, Record

NAMES = tuple(COLUMNS.values())
UNITS = {1e-3: "kPa", 1e3: "mPa", 1.0 / 6894.757: "psi", 1e-5: "bar", 1e-6: "MPa"}
"""Unit by what a pressure in it is of one in Pa."""
ALIKE = np.log(1.6)
"""How far a gain may lie from a unit's, as a logarithm; units are at least 6.9 apart."""
ANSWERS = 0.6
"""Share of its rms that a pressure leaves of the drive's response, above which it is no answer."""
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


class Answers:
    """Fits of all trials, and the lag and delay that serve most of them."""

    def __init__(self, records: Sequence[Record], chambers: Sequence[tuple[Drive, Drive]]):
        self.all = [_fitted(r, c) for r, c in zip(records, chambers, strict=True)]
        best = np.stack([f.left.min(axis=0) for f in self.all])
        middle = np.median(best.reshape(-1, *best.shape[2:]), axis=0)
        lag, delay = np.unravel_index(int(middle.argmin()), middle.shape)
        self.at = int(lag), int(delay)
        """Index of that lag and delay."""

    def gain(self, i: int) -> np.ndarray:
        """(2 or 5, 2) of trial i: columns against drives, at that lag and delay."""
        return self.all[i].gain[:, :, self.at[0], self.at[1]]

    def left(self, i: int) -> np.ndarray:
        """(2 or 5, 2) likewise."""
        return self.all[i].left[:, :, self.at[0], self.at[1]]

    def own(self, i: int) -> np.ndarray:
        """(2,) what the pressures leave at the lag and delay that suit them best."""
        left = self.all[i].left
        return np.array([left[c, c].min() for c in (0, 1)])


def _fitted(r: Record, chambers: tuple[Drive, Drive]) -> Fits:
    """Fits of the pressures; of all columns where the pressures' own are no answer."""
    found = fits(r.t, r.values[:2], chambers)
    plain = (found.left.min(axis=(0, 2, 3)) < ANSWERS).all() and not any(
        _tiny(r, c) for c in (0, 1)
    )
    return found if plain else fits(r.t, r.values, chambers)


def check(records: Sequence[Record], rate: float | None) -> tuple[list[Record], list[Finding]]:
    """Records mended where that is unambiguous, without those left out, and findings.

    `rate` [Hz] is the declared sample rate, or None.
    """
    plain = [r for r in records if drives(r.trial) is None]
    driven = [r for r in records if drives(r.trial) is not None]
    driven, findings = _skewed(driven, rate)
    answers = Answers(driven, _chambers(driven)) if driven else None
    for step in (_columns, _units, _front_and_rear, _declared):
        if answers is None:
            break
        driven, more = step(driven, answers)
        findings += more
        if more:
            answers = Answers(driven, _chambers(driven)) if driven else None
    order = {r.trial.file: i for i, r in enumerate(records)}
    return sorted([*plain, *driven], key=lambda r: order[r.trial.file]), findings


def _chambers(records: Sequence[Record]) -> list[tuple[Drive, Drive]]:
    found = [drives(r.trial) for r in records]
    return [x for x in found if x is not None]


def _skewed(records: Sequence[Record], rate: float | None) -> tuple[list[Record], list[Finding]]:
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
            findings.append(_finding(r, "clock_skew", "t_s", how, "mended"))
        elif abs(p.off) < MOST_SKEW:
            how = f"{said}: its clock is skewed, or another frequency was run than declared"
            findings.append(_finding(r, "clock_skew", "t_s", how, "left out"))
        else:
            how = f"{said}: another frequency was run than declared{_partner(records, r)}"
            findings.append(_finding(r, "wrong_drive", "p_front, p_rear", how, "left out"))
    return kept, findings


def _clock(r: Record) -> Pace | None:
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
    return Pace(off, error) if agree else None


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
            if fit and not ordinary and (strange or _tiny(r, c)):
                other = min(fit, key=lambda x: left[x, c])
                order[c], order[other] = other, c
        if order == list(range(5)):
            kept.append(r)
            continue
        moved = [NAMES[x] for x in range(5) if order[x] != x]
        how = f"the columns {' and '.join(moved)} are swapped: each holds what the other should"
        findings.append(_finding(r, "swapped_columns", ", ".join(moved), how, "mended"))
        kept.append(replace(r, values=r.values[order]))
    return kept, findings


def _tiny(r: Record, row: int) -> bool:
    """Whether a column that should be a pressure in Pa holds numbers of another size."""
    there = r.values[row][np.isfinite(r.values[row])]
    return bool(there.size and np.abs(there).max() < 1e-3 * (r.trial.amplitude or 0.0))


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
                findings.append(_finding(r, "units", CHANNELS[c], how, "mended"))
            if gain < 0.0:
                how = f"{NAMES[c]} has the drive's sign turned; it was turned back"
                values[c] *= -1.0
                findings.append(_finding(r, "sign", CHANNELS[c], how, "mended"))
        kept.append(replace(r, values=values))
    return kept, findings


def _front_and_rear(
    records: Sequence[Record], answers: Answers
) -> tuple[list[Record], list[Finding]]:
    """Front and rear pressure in each other's column, from the rear's phase and amplitude."""
    both = [_pair(r) for r in records]
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
        findings.append(_finding(r, "swapped_columns", "p_front, p_rear", how, "mended"))
        kept.append(replace(r, values=r.values[[1, 0, 2, 3, 4]]))
    return kept, findings


def _pair(r: Record) -> tuple[float, float] | None:
    """The rear column's lag behind the front's (fraction of a period), and front over rear."""
    tones = []
    for row in (0, 1):
        there = np.isfinite(r.values[row])
        if there.mean() < 0.5 or not r.trial.frequency:
            return None
        tones.append(tone(r.t[there], r.values[row, there], r.trial.frequency))
    front, rear = tones
    if not front.amplitude or not rear.amplitude:
        return None
    return rear.lag - front.lag, front.amplitude / rear.amplitude


def _wrapped(turn: float) -> float:
    return (turn + 0.5) % 1.0 - 0.5


def _swapped_by_phase(r: Record, found: tuple[float, float] | None) -> bool | None:
    """None where the phase declared does not tell the two apart."""
    if found is None:
        return None
    straight, crossed = (abs(_wrapped(found[0] - s * r.trial.phase)) for s in (1.0, -1.0))
    if abs(_wrapped(2.0 * r.trial.phase)) < 0.1:
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


def _declared(records: Sequence[Record], answers: Answers) -> tuple[list[Record], list[Finding]]:
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
        for i, finding in check_([records[i] for i in good], answers, good).items():
            wrong.setdefault(i, finding)
    kept = [r for i, r in enumerate(records) if i not in wrong]
    return kept, [wrong[i] for i in sorted(wrong)]


def _another_drive(records: Sequence[Record], i: int, bad: Sequence[int]) -> Finding:
    r, names = records[i], " and ".join(NAMES[c] for c in bad)
    how = (
        f"{names} cannot be the answer to the drive declared ({r.trial.frequency:g} Hz), as those "
        f"of the other trials are{_partner(records, r)}"
    )
    return _finding(r, "wrong_drive", ", ".join(CHANNELS[c] for c in bad), how, "left out")


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
    around = DELAYS[answers.at[1]] + np.arange(-0.3, 0.3, 0.005)
    lag = TIME_CONSTANTS[[answers.at[0]]]
    delays, least = [], []
    for r, chambers in zip(records, _chambers(records), strict=True):
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
            found[index[j]] = _finding(r, "time_offset", "t_s", how, "left out")
    return found


def _off_phase(
    records: Sequence[Record], answers: Answers, index: Sequence[int]
) -> dict[int, Finding]:
    """Rear chambers that ran at another phase than declared."""
    pairs = [_pair(r) for r in records]
    off = np.array(
        [
            np.nan if p is None else _wrapped(p[0] - r.trial.phase) / (r.trial.frequency or 1.0)
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
        turns = _wrapped((off[j] - usual) * r.trial.frequency)
        if abs(turns) > max(OFF_PHASE, 8.0 * spread * r.trial.frequency):
            how = (
                f"the rear pressure follows the front by {_wrapped(r.trial.phase + turns):.2f} of "
                f"a period; declared is {r.trial.phase:g}"
            )
            found[index[j]] = _finding(r, "wrong_phase", "p_rear", how, "left out")
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
            found[index[j]] = _finding(r, "wrong_amplitude", "p_front, p_rear", how, "left out")
    return found


def _finding(r: Record, kind: str, channel: str, how: str, action) -> Finding:
    return Finding(r.trial.file, kind, channel, float(r.t[0]), float(r.t[-1]), how, action)
