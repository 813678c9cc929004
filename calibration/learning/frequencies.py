"""Searches for the frequency of a sine in the residuals of all trials."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from calibration.discrepancy.localise import locate_residuals
from calibration.inference.gauss_newton import Fit
from calibration.inference.goodness import tested_excess
from calibration.inference.problem import TankProblem

MOST_PERIODS = 20
"""Largest number of periods of a common sine in the longest trial. The spectrum of a single trial
determines the frequency of a faster sine."""
PER_INTERVAL = 8
"""Number of tested frequencies per Fourier interval of the longest trial."""
AT_ONCE = 16
"""Number of frequencies whose sines are whitened together. With 16, the search needs a fifth of the
time, and an array of sines has 77 MB for 300,000 samples."""


class SinePeak(NamedTuple):
    """A sine in the residual of one sensor."""

    p: float
    """p-value of the sine, or 1 if no trial has a significant sine."""
    share: float
    """Share of the sine in the sum of squares."""
    frequency: float
    """Frequency [Hz]."""


def best_peak(peaks: Sequence[SinePeak]) -> SinePeak:
    """Returns the peak with the smallest p-value; among equal p-values, with the largest share."""
    return min(peaks, key=lambda x: (x.p, -x.share))


class WhiteSeries(NamedTuple):
    """Times [s] (n,) of a trial's readings, their whitened residual (n,), and the whitener.

    The whitener transforms series (k, n) of the readings to whitened series (k, n). The `envelope`
    (n,) multiplies the sines that are searched for.
    """

    t: np.ndarray
    residual: np.ndarray
    whiten: Callable[[np.ndarray], np.ndarray]
    envelope: np.ndarray | float = 1.0


def common_sine(series: Sequence[WhiteSeries], peak: float) -> tuple[float, float]:
    """Returns share and frequency [Hz] of the sine that explains most of all series together.

    The tested frequencies have 1 to `MOST_PERIODS` periods in the longest series. The frequency
    `peak` [Hz] of the largest peak in the spectrum of one series is tested too.

    The sine has the same amplitude and phase in all trials, as a sine of the dictionary has. The
    share is the reduction of the sum of squares, divided by the sum of squares. A trial that
    contains fewer than two periods does not determine the frequency. Several trials together can
    determine it, because each trial adds information on the common phase and frequency.
    """
    longest = max(float(np.ptp(x.t)) for x in series)
    slow = np.arange(PER_INTERVAL, MOST_PERIODS * PER_INTERVAL + 1) / (PER_INTERVAL * longest)
    hertz, square = np.append(slow, peak), sum(float(x.residual @ x.residual) for x in series)
    parts = [hertz[i : i + AT_ONCE] for i in range(0, len(hertz), AT_ONCE)]
    gains = np.concatenate([_gains(series, part) for part in parts])
    best = int(np.argmax(gains))
    return float(gains[best]) / square, float(hertz[best])


def _gains(series: Sequence[WhiteSeries], hertz: np.ndarray) -> np.ndarray:
    """Returns the reduction of the sum of squares by a sine of each frequency [Hz]."""
    A, b = np.zeros((len(hertz), 2, 2)), np.zeros((len(hertz), 2, 1))
    for x in series:
        turn = 2.0 * np.pi * hertz[:, None] * x.t
        rows = x.envelope * np.stack([np.sin(turn), np.cos(turn)], axis=1)
        white = x.whiten(rows.reshape(-1, len(x.t))).reshape(rows.shape)
        A += white @ white.mT
        b += white @ x.residual[:, None]
    gains = (b.mT @ np.linalg.pinv(A, hermitian=True) @ b)[:, 0, 0]
    return np.where(np.isfinite(gains), gains, 0.0)


def sine_peaks(part: TankProblem, fit: Fit, noise_floor: float) -> dict[tuple[str, bool], SinePeak]:
    """Returns the most significant sine in the residual of each sensor above the `noise_floor`.

    `fit` is a fit to the trials of `part`. If no trial has a significant sine, the result is the
    sine that explains most of all trials together. The result for (sensor, False) is a sine. The
    result for (sensor, True) is a sine that multiplies the predicted readings. Its frequency is one
    of the frequencies of `common_sine`, so the sine is slow.
    """
    found = dict[tuple[str, bool], SinePeak]()
    left, white = tested_excess(part, fit), part.whiteners(fit.predicted)
    residuals = part.residuals(fit.predicted, white)
    for x in locate_residuals(part.records, fit.predicted, left, noise_floor):
        channel = x["channel"]
        sensor = "pressure" if channel in part.all_channels.pressures else channel
        lines = [p for p in left[channel].patterns if p.has_line]
        significant = [SinePeak(p.line_p, p.line, p.frequency_Hz) for p in lines]
        highest, row = x["in_worst_trial"]["peak_Hz"], part.all_channels.row(channel)
        series = []
        for (i, name), r in residuals.items():
            if name == channel:
                there = part.records[i].there(channel)
                y = fit.predicted[i][row][there]
                series.append(WhiteSeries(part.records[i].t[there], r, white[i, channel], y))
        for of_gain in (False, True):
            peaks = [] if of_gain else significant
            if not peaks:
                given = series if of_gain else [s._replace(envelope=1.0) for s in series]
                peaks = [SinePeak(1.0, *common_sine(given, highest))]
            if (sensor, of_gain) in found:
                peaks = [*peaks, found[sensor, of_gain]]
            found[sensor, of_gain] = best_peak(peaks)
    return found
