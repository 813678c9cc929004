"""Tests whether the whitened residual of a trial and channel is white noise.

There are two tests: the test of Ljung and Box for a correlation of neighbouring readings, and
Fisher's test for a single sine. With thousands of readings, even a negligible deviation is
significant. A series therefore fails a test only if the deviation is significant and also large.

Source: Ljung, G. M. and Box, G. E. P. (1978), Biometrika 65, 297-303; Fisher, R. A. (1929), Proc.
R. Soc. A 125, 54-59.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import gamma

from calibration.measurements.records import Record

SPREAD = 4.0
"""The variance of Ljung and Box's statistic is 2 m (1 + `SPREAD` m/n) for m lags and n readings.
The chi-squared distribution has the variance 2 m. With this distribution, p-values below 1e-4 were
22 times too frequent in 200,000 simulated series of 80 readings of white noise."""
FALSE_ALARM_P = 0.01
"""Probability that at least one of all series of white noise fails a test (Bonferroni)."""
MAX_LAGS, LAG_SHARE = 20, 5
"""The number of lags in the test of Ljung and Box is the smaller of `MAX_LAGS` and the number of
readings divided by `LAG_SHARE`."""
MIN_CORRELATION = 0.3
"""A correlation counts as large only if the sum of its squared autocorrelations exceeds this value.
The discrepancy model is not exact: in the null data sets of the independent program, the sum
reaches 0.22."""
MIN_LINE = 0.1
"""A sine counts as large only if its share of the sum of squares exceeds this value. In the null
data sets, significant shares reach 0.08. A sine with this share has 0.47 times the amplitude of the
white noise."""
TRIAL_SHARE = 1.5
"""Largest discrepancy of a single trial, divided by the discrepancy of the channel. For the
pressures, `slider_jax/channels.py` sets the discrepancy to 0.2 % of the rms, but single trials had
up to 0.3 %."""
FEWEST = 40
"""A series with fewer readings is not tested."""
PADDING = 16
"""A sine is located on a grid with this many frequencies per Fourier interval."""


class SeriesTest(NamedTuple):
    """Result of both tests for one trial and channel.

    The p-values are corrected for the number of all tests (Bonferroni).
    """

    trial: str
    """Name of the trial's file."""
    channel: str
    correlation: float
    """Sum of the squared autocorrelations, minus the sum expected for white noise."""
    correlation_p: float
    line: float
    """Largest share of one frequency in the sum of squares."""
    line_p: float
    frequency_Hz: float
    """Frequency of the sine that explains most of the whitened residual."""
    amplitude: float
    """Amplitude of this sine in the measured minus predicted readings, in the channel's unit."""
    least_amplitude: float = 0.0
    """Amplitude of a sine whose rms is the model-discretisation discrepancy of a single trial. A
    smaller sine does not make the series fail the test, because the sine can be part of the
    discrepancy."""

    @property
    def correlated(self) -> bool:
        """Returns whether the series has a significant and large correlation."""
        return self.correlation > MIN_CORRELATION and self.correlation_p < FALSE_ALARM_P

    @property
    def has_line(self) -> bool:
        """Returns whether the series has a significant and large sine."""
        large = self.line > MIN_LINE and self.amplitude > self.least_amplitude
        return large and self.line_p < FALSE_ALARM_P


def whiteness_tests(
    records: Sequence[Record],
    predicted: Sequence[np.ndarray],
    residuals: Mapping[tuple[int, str], np.ndarray],
    discrepancies: Mapping[str, float],
) -> list[SeriesTest]:
    """Returns the tests of the whitened `residuals` of each trial (index) and channel.

    `predicted` are the readings (channels, samples) of the model. `discrepancies` are the
    discrepancies of the channels, as fractions of the rms. The function omits series with fewer
    than `FEWEST` readings, and series with readings that are not finite.
    """
    found = []
    for (i, channel), white in residuals.items():
        if len(white) < FEWEST or not np.isfinite(white).all():
            continue
        there, row = records[i].there(channel), records[i].row(channel)
        t, raw = records[i].t[there], (records[i].values[row] - predicted[i][row])[there]
        place = sample_places(t)
        correlation, line = ljung_box(white, place), fisher_line(white, place)
        sine = sine_at_peak(t, raw, white)
        share = TRIAL_SHARE * discrepancies[channel]
        least = float(np.sqrt(2.0) * share * np.std(predicted[i][row][there]))
        name = records[i].trial.file
        found.append(SeriesTest(name, channel, *correlation, *line, *sine, least))
    many = 2 * len(found)
    return [
        x._replace(correlation_p=min(1.0, many * x.correlation_p), line_p=min(1.0, many * x.line_p))
        for x in found
    ]


def sample_places(t: np.ndarray) -> np.ndarray:
    """Returns the index (n,) of each sample in an evenly spaced series.

    t (n,) are the times of the samples [s].
    """
    return np.round((t - t[0]) / np.median(np.diff(t))).astype(int)


def _even(x: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Returns the series x (n,) minus its mean, with zeros for missing samples."""
    even = np.zeros(place[-1] + 1)
    even[place] = x - x.mean()
    return even


def ljung_box(x: np.ndarray, place: np.ndarray) -> tuple[float, float]:
    """Returns the size and the p-value of the correlation in a series x (n,).

    `place` (n,) are the sample numbers; missing numbers are gaps. The size is the sum of the
    squared autocorrelations, minus its expectation for white noise. The p-value is computed with a
    gamma distribution. Its mean is m and its variance is 2 m (1 + `SPREAD` m/n), where m is the
    number of lags. The chi-squared distribution is the limit of long series.
    """
    n, lags = len(x), min(MAX_LAGS, len(x) // LAG_SHARE)
    y, there = _even(x, place), np.zeros(place[-1] + 1)
    there[place] = 1.0
    rho = np.array([y[k:] @ y[:-k] for k in range(1, lags + 1)]) / max(float(y @ y), 1e-300)
    pairs = np.maximum([there[k:] @ there[:-k] for k in range(1, lags + 1)], 1.0)
    Q = n * (n + 2.0) * float(np.sum(rho**2 / pairs))
    scale = 2.0 * (1.0 + SPREAD * lags / n)
    return (Q - lags) / n, float(gamma.sf(Q, lags / scale, scale=scale))


def fisher_line(x: np.ndarray, place: np.ndarray) -> tuple[float, float]:
    """Returns the largest share g of one frequency in a series x (n,), and its p-value.

    The frequencies are the Fourier frequencies and the middle between each two of them, because the
    share of a sine between two Fourier frequencies is smaller by up to 60 %. The p-value is the
    first term of Fisher's sum, which is an upper bound, times 2 for the additional frequencies.
    """
    even = _even(x, place)
    count = (len(even) - 1) // 2
    power = np.abs(np.fft.rfft(even, 2 * len(even))[1 : 2 * count + 1]) ** 2
    g = min(float(power.max() / max(float(power[1::2].sum()), 1e-300)), 1.0)
    return g, min(1.0, 2.0 * count * (1.0 - g) ** (count - 1))


def sine_at_peak(t: np.ndarray, raw: np.ndarray, white: np.ndarray) -> tuple[float, float]:
    """Returns frequency [Hz] and amplitude of the sine with most power in the residual `white`.

    Whitening shifts a peak away from the harmonics of the drive. The result is therefore the
    frequency of the largest power in the series `raw` (n,), within half a Fourier interval of the
    peak. The amplitude is that of a sine that is fitted to `raw` by least squares, together with a
    constant.
    """
    place = sample_places(t)
    count = PADDING * (place[-1] + 1)
    hertz = np.fft.rfftfreq(count, float(np.median(np.diff(t))))
    whitened, power = (np.abs(np.fft.rfft(_even(x, place), count)) ** 2 for x in (white, raw))
    near = np.abs(np.arange(len(hertz)) - np.argmax(whitened)) <= PADDING // 2
    frequency = float(hertz[np.argmax(np.where(near, power, 0.0))])
    turn = 2.0 * np.pi * frequency * t
    columns = np.stack([np.cos(turn), np.sin(turn), np.ones_like(t)], axis=1)
    cosine, sine, _ = np.linalg.lstsq(columns, raw, rcond=None)[0]
    return frequency, float(np.hypot(cosine, sine))
