"""The audit of the rig's pressure logs: what the instrument does that no pneumatics can.

Is every code of a quantised sensor read as often as its neighbours?

A converter whose codes are not equally wide reads the narrow ones too seldom, and, as each stands
for less pressure, with more noise in counts. Signals make uneven histograms too: the null is made
of the same logs, smoothed, given white noise and rounded anew, so that it holds all that the signal
does. Both signs must show at one period: the density waves by more than any null's does, and the
noise is high where the density is low.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from calibration.audit.sensors import clipped, grain
from calibration.measurements.findings import Action, Finding, masked
from calibration.pressure_logs.read import PSI_PER_COUNT, ManifoldLog

PERIODS = np.geomspace(3.0, 48.0, 400)
"""In codes, that are looked at."""


SMOOTH = 12.0
"""Codes over which a histogram is smoothed to say what it should be."""


SETTLE = 8.0
"""Samples over which a log is smoothed to make a null."""


LEAST_COUNT = 8.0
"""Expected readings of a code from which on it is looked at."""


NULLS = 40


RARE = 0.5
"""A code is rare that is read less often than this share of what it should be."""


OPPOSED = -0.8
"""Correlation of log density and log noise over the wave's phase below which widths differ."""


class CodeDensity(NamedTuple):
    """The unevenness of a sensor's codes."""

    amplitude: float
    """Share by which the density waves about what it should be, at its strongest period."""
    null: np.ndarray
    """(nulls,) the same of smooth signals with the same noise, at their strongest periods."""
    period: float
    """Codes."""
    opposed: float
    """Correlation of log density with log noise over the wave's phase: -1 if widths make both."""
    dnl: float
    """Largest error of a code's width over the phase of the wave, in codes."""
    inl: float
    """Half the range of a reading's error, in codes: the widths' errors summed over the wave."""
    missing: list[int]
    """Codes that should have been read and never were."""
    rare: list[int]
    """Codes read less than `RARE` times as often as they should be."""

    @property
    def significance(self) -> float:
        """By how many standard deviations of the null the amplitude exceeds its mean."""
        return float((self.amplitude - self.null.mean()) / max(float(self.null.std()), 1e-12))

    @property
    def uneven(self) -> bool:
        """Whether the codes are not equally wide."""
        return self.amplitude > 1.5 * float(self.null.max()) and self.opposed < OPPOSED


def code_density(
    series: Sequence[np.ndarray], seed: int = 0, nulls: int = NULLS
) -> CodeDensity | None:
    """Test readings of one sensor, each of `series` (n,) a log in order of time, in whole codes.

    None where there are too few readings of too few codes to say anything. The result is the same
    for the same `seed`.
    """
    logs = [np.asarray(x, float) for x in series if len(x) > 4 * SETTLE]
    if not logs or any((x != np.round(x)).any() for x in logs):
        return None
    codes, seen, expected = _histogram(logs)
    looked = expected > LEAST_COUNT
    if looked.sum() < 3 * PERIODS[0] or np.ptp(codes[looked]) < 40:
        return None
    amplitude, period = _strongest(codes, seen, expected)
    rng = np.random.default_rng(seed)
    null = np.array([_strongest(*_histogram(_null(logs, rng)))[0] for _ in range(nulls)])
    rare = looked & (seen < RARE * expected)
    widths, opposed = _over_phase(logs, codes, seen, expected, period)
    wrong = np.cumsum(widths - widths.mean()) * period / len(widths)
    return CodeDensity(
        amplitude,
        null,
        period,
        opposed,
        float(np.abs(widths - 1.0).max()),
        0.5 * float(np.ptp(wrong)),
        [int(c) for c in codes[looked & (seen == 0)]],
        [int(c) for c in codes[rare]],
    )


def _null(logs: Sequence[np.ndarray], rng: np.random.Generator) -> list[np.ndarray]:
    """Smooth signals like the logs, with white noise of the logs' size, in codes."""
    found = []
    for x in logs:
        noise = float(np.sqrt(max(np.mean(np.diff(x, 4) ** 2) / 70.0 - 1.0 / 12.0, 0.0)))
        smooth = gaussian_filter1d(x, SETTLE, mode="nearest")
        found.append(np.round(smooth + noise * rng.normal(size=len(x))))
    return found


def _histogram(logs: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Codes, how often each is read, and how often it should be by its neighbours."""
    low = int(min(x.min() for x in logs))
    high = int(max(x.max() for x in logs))
    codes = np.arange(low, high + 1)
    seen, expected = np.zeros(len(codes)), np.zeros(len(codes))
    for x in logs:
        counts = np.bincount((x - low).astype(int), minlength=len(codes)).astype(float)
        seen += counts
        expected += gaussian_filter1d(counts, SMOOTH, mode="constant")
    return codes, seen, expected


def _strongest(codes: np.ndarray, seen: np.ndarray, expected: np.ndarray) -> tuple[float, float]:
    """Amplitude in relative density, and length [codes], of the strongest period."""
    looked = expected > LEAST_COUNT
    x, share = codes[looked], seen[looked] / expected[looked] - 1.0
    weight = np.minimum(expected[looked], np.median(expected[looked]))
    weight /= weight.sum()
    share = share - weight @ share
    waves = np.exp(2j * np.pi * x[None] / PERIODS[:, None])
    sums = waves @ (weight * share)
    best = int(np.argmax(np.abs(sums)))
    return float(2.0 * np.abs(sums[best])), float(PERIODS[best])


def _over_phase(
    logs: Sequence[np.ndarray],
    codes: np.ndarray,
    seen: np.ndarray,
    expected: np.ndarray,
    period: float,
) -> tuple[np.ndarray, float]:
    """Relative density (bins,) over the wave's phase, and its log's correlation with log noise."""
    bins = max(min(12, int(period)), 3)
    phase = ((codes % period) / period * bins).astype(int)
    noise, many = np.zeros(len(codes)), np.zeros(len(codes))
    for x in logs:
        # The code is told by other samples than the noise: a reading that its own noise carried
        # to a rare code would make noise and rareness go together.
        at = np.round(0.5 * (x[:-4] + x[4:]) - codes[0]).astype(int)
        np.add.at(noise, at, np.abs(np.diff(x[1:-1], 2)))
        np.add.at(many, at, 1.0)
    looked = (expected > LEAST_COUNT) & (many > 0)
    density, loud = np.ones(bins), np.ones(bins)
    for b in range(bins):
        here = looked & (phase == b)
        if here.any():
            density[b] = seen[here].sum() / expected[here].sum()
            loud[b] = noise[here].sum() / many[here].sum()
    if min(density.min(), loud.min()) <= 0.0 or density.std() == 0.0 or loud.std() == 0.0:
        return density, 0.0
    return density, float(np.corrcoef(np.log(density), np.log(loud))[0, 1])


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
