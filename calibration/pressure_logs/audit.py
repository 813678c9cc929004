"""Checks the rig's pressure logs for faults of the instrument, such as codes of unequal width.

A code is an integer reading of the converter. The density of a code is the number of readings of
this code, divided by the expected number. If a code is too narrow (covers too small a range of
pressures), its density is low. The noise in counts is then high: the same noise in Pa is more
counts. The signal also makes densities uneven, so the test needs null samples: smoothed logs with
new white noise, rounded to codes. Codes have unequal widths if the density varies periodically with
the code, more than in every null sample, and if the noise is high where the density is low.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from calibration.audit.sensors import clipped, quantisation
from calibration.measurements.records import Action, Finding, masked_finding
from calibration.pressure_logs.read import PSI_PER_COUNT, ManifoldLog

PERIODS = np.geomspace(3.0, 48.0, 400)
"""Periods [codes] of the variation of the density that the test examines."""
HISTOGRAM_WIDTH = 12.0
"""Standard deviation [codes] of the Gaussian filter that gives the expected histogram."""
SIGNAL_WIDTH = 8.0
"""Standard deviation [samples] of the Gaussian filter that smooths a log for a null sample."""
LEAST_COUNT = 8.0
"""The test examines a code only if its expected number of readings exceeds this value."""
NULLS = 40
"""Number of null samples."""
RARE = 0.5
"""A code is rare if its density is below this value."""
OPPOSED = -0.8
"""The test reports unequal widths of codes only if `CodeDensity.opposed` is below this value."""


class CodeDensity(NamedTuple):
    """The density of a sensor's codes: number of readings divided by the expected number."""

    amplitude: float
    """Relative amplitude of the strongest sine wave in the density as a function of the code."""
    null: np.ndarray
    """Relative amplitude of the strongest wave in each null sample, shape (nulls,)."""
    period: float
    """Period [codes] of the strongest wave in the density."""
    opposed: float
    """Correlation of log(density) and log(noise) in one period; near -1 if widths are unequal."""
    dnl: float
    """Largest error [codes] of a code's width in one period of the wave."""
    inl: float
    """Half of the range of a reading's error [codes], the cumulative sum of the width errors."""
    missing: list[int]
    """Examined codes that have no reading."""
    rare: list[int]
    """Examined codes with a density below `RARE`."""

    @property
    def significance(self) -> float:
        """`amplitude` minus the mean of `null`, divided by the standard deviation of `null`."""
        return float((self.amplitude - self.null.mean()) / max(float(self.null.std()), 1e-12))

    @property
    def uneven(self) -> bool:
        """Whether the codes have unequal widths."""
        return self.amplitude > 1.5 * float(self.null.max()) and self.opposed < OPPOSED


def code_density(
    series: Sequence[np.ndarray], seed: int = 0, nulls: int = NULLS
) -> CodeDensity | None:
    """Returns the code density of one sensor. `series` has an array (n,) of readings for each log.

    Returns None if readings are not integers, or if there are too few readings or codes. `nulls` is
    the number of null samples. `seed` is the seed of the null samples' random noise.
    """
    logs = [np.asarray(x, float) for x in series if len(x) > 4 * SIGNAL_WIDTH]
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
    """Returns a null sample [codes]: smoothed logs with new white noise of the same variance."""
    found = []
    for x in logs:
        noise = float(np.sqrt(max(np.mean(np.diff(x, 4) ** 2) / 70.0 - 1.0 / 12.0, 0.0)))
        smooth = gaussian_filter1d(x, SIGNAL_WIDTH, mode="nearest")
        found.append(np.round(smooth + noise * rng.normal(size=len(x))))
    return found


def _histogram(logs: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns codes, their numbers of readings, and expected numbers of readings, each (codes,)."""
    low, high = (int(f([f(x) for x in logs])) for f in (np.min, np.max))
    codes = np.arange(low, high + 1)
    seen, expected = np.zeros(len(codes)), np.zeros(len(codes))
    for x in logs:
        counts = np.bincount((x - low).astype(int), minlength=len(codes)).astype(float)
        seen += counts
        expected += gaussian_filter1d(counts, HISTOGRAM_WIDTH, mode="constant")
    return codes, seen, expected


def _strongest(codes: np.ndarray, seen: np.ndarray, expected: np.ndarray) -> tuple[float, float]:
    """Returns relative amplitude and period [codes] of the strongest wave in the density."""
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
    """Returns the density (bins,) in one period, and the field `opposed` of `CodeDensity`."""
    bins = max(min(12, int(period)), 3)
    phase = ((codes % period) / period * bins).astype(int)
    noise, many = np.zeros(len(codes)), np.zeros(len(codes))
    for x in logs:
        # Code and noise come from different samples. Otherwise, noise that moves a sample to a rare
        # code would cause a correlation between noise and density.
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
"""Published firmware: one valve is closed, the other has duty min(250, 10 |error in counts|)."""
DUTY_ERROR = 1.5
"""Largest rounding error of a duty (0 to 255)."""
MAX_ERROR_SHARE = 0.01
"""The audit reports a finding if more than this fraction of samples contradicts the valve law."""
MAX_JITTER = 1.0
"""The audit reports a finding if a sample time is wrong by more than this number of samples."""


def audit_logs(logs: Sequence[ManifoldLog]) -> list[Finding]:
    """Returns the faults of the logs and of the sensor that recorded all logs.

    The faults are repaired rows, clipped readings, valve duties that contradict the firmware's
    control law, sample times that contradict the sine command, and codes of unequal width.
    """
    findings = []
    for log in logs:
        name = log.path.name
        for row in log.findings:
            action: Action = "mended" if "dropped" in row.detail else "used"
            findings.append(Finding(name, "log_row", None, None, None, str(row), action))
        bad = clipped(log.pressure, quantisation(log.pressure, 0.0))
        if bad.any():
            ends = " and ".join(f"{x:.0f}" for x in sorted(set(log.pressure[bad][[0, -1]])))
            text = f"the pressure is clipped near {ends} counts"
            findings.append(masked_finding(name, "clipped", "pressure", log.t, bad, text))
        findings += _duties(log) + _times(log)
    density = code_density([log.pressure for log in logs])
    if density is not None and density.uneven:
        names = ", ".join(log.path.name for log in logs)
        findings.append(
            Finding(names, "code_density", "pressure", None, None, _unequal(density), "used")
        )
    return findings


def _unequal(found: CodeDensity) -> str:
    """Returns the text of the finding on unequal pressure codes, in counts and psi."""
    rare = f"; {len(found.rare)} codes are rare" if found.rare else ""
    rare += f"; {len(found.missing)} codes are missing" if found.missing else ""
    return (
        "the pressure codes have unequal widths. The density (readings of a code, divided by the "
        f"expected number of readings) varies by {found.amplitude:.0%} with a period of "
        f"{found.period:.1f} counts, {found.significance:.0f} standard deviations more than for "
        "smooth signals with the same noise. The noise is high where the density is low "
        f"(correlation {found.opposed:.2f}){rare}. The error of a width is up to {found.dnl:.2f} "
        f"counts. The error of a reading is up to {found.inl:.1f} counts or "
        f"{found.inl * PSI_PER_COUNT:.2f} psi. The cause is the converter, not the pneumatics"
    )


def _duties(log: ManifoldLog) -> list[Finding]:
    """Returns a finding if valve duties contradict the pressure error in the same row."""
    error = log.command - log.pressure
    law = np.minimum(FULL_DUTY, DUTY_PER_COUNT * np.abs(error))
    fill, vent = np.where(error > 0.0, law, 0.0), np.where(error > 0.0, 0.0, law)
    wrong = (np.abs(log.fill - fill) > DUTY_ERROR) | (np.abs(log.vent - vent) > DUTY_ERROR)
    if wrong.mean() <= MAX_ERROR_SHARE:
        return []
    first = float(log.t[np.argmax(wrong)])
    detail = (
        f"{wrong.mean():.1%} of the valve duties differ from min(250, 10 |error|) in the same row, "
        f"first at {first:.3f} s; the columns' sample times differ, or another firmware was used"
    )
    return [Finding(log.path.name, "duty", "valves", first, None, detail, "used")]


def _times(log: ManifoldLog) -> list[Finding]:
    """Returns a finding if the sine command contradicts the sample times."""
    turn = 2.0 * np.pi * log.frequency * log.t
    columns = np.stack([np.cos(turn), np.sin(turn), np.ones_like(turn)], axis=1)
    a, b, c = np.linalg.lstsq(columns, log.command)[0]
    slope = 2.0 * np.pi * log.frequency * (b * np.cos(turn) - a * np.sin(turn))
    steep = np.abs(slope) > 0.7 * np.abs(slope).max()
    if not np.abs(slope).max() > 0.0:
        return []
    late = (log.command - columns @ np.array([a, b, c]))[steep] / slope[steep]
    worst = float(np.abs(late).max()) / log.period
    if worst <= MAX_JITTER:
        return []
    detail = (
        f"the command is up to {1e3 * worst * log.period:.1f} ms earlier or later than a sine with "
        "the frequency of the header: samples are missing or late"
    )
    return [Finding(log.path.name, "clock", "t_s", None, None, detail, "used")]
