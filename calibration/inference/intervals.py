"""Computes confidence intervals of a parameter x if the residuals of its fit are correlated."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

CONFIDENCE = 0.95


class Interval(NamedTuple):
    """Value and 95 % interval of a positive parameter x, if the residuals are correlated."""

    value: float
    low: float
    high: float
    effective: float
    """Effective number of samples."""
    widening: float
    """Width of the interval of log x, divided by the width for independent residuals."""

    @property
    def fixed(self) -> bool:
        """Whether `high` is less than ten times `low`."""
        return self.high < 10.0 * self.low


class RecordDerivatives(NamedTuple):
    """Residual r of one record at the fitted x, J = dr/d(log x), and H = d^2(r.r/2)/d(log x)^2."""

    residual: np.ndarray
    tangent: np.ndarray
    curvature: float


def correlation_time(residual: np.ndarray) -> float:
    """Returns n divided by the effective number of independent samples of a residual (n,).

    The result is 1 + 2 c. Here c is the sum of the residual's autocorrelation up to its first zero.
    A residual that repeats in every cycle has four to six independent samples per cycle.
    """
    x = residual - residual.mean()
    n = len(x)
    spectrum = np.fft.rfft(x, 2 * n)
    rho = np.fft.irfft(spectrum * spectrum.conj())[:n]
    if rho[0] <= 0.0:
        return 1.0
    rho = rho / rho[0]
    below = np.flatnonzero(rho <= 0.0)
    return float(1.0 + 2.0 * rho[1 : below[0] if below.size else n].sum())


def student_quantile(freedom: float) -> float:
    """Returns Student's two-sided 95 % quantile for `freedom` degrees of freedom."""
    return float(stdtrit(max(freedom, 1.0), 0.5 + 0.5 * CONFIDENCE))


def record_interval(log_value: float, record: RecordDerivatives) -> Interval:
    """Returns the interval of a least-squares fit to one record.

    The variance of log x is the sandwich estimate s^2 tau J.J/H^2. s^2 is the residual's variance,
    and tau its `correlation_time`. H differs from J.J if the residual is large.
    """
    r, J, H = record
    n, time = len(r), correlation_time(r)
    effective = max(n / time, 2.0)
    s2, JJ = float(r @ r) / max(n - 1, 1), float(J @ J)
    naive = student_quantile(n - 1.0) * math.sqrt(s2 / JJ) if JJ else math.inf
    deviation = math.sqrt(s2 * time * JJ) / H if H > 0.0 else math.inf
    return _around(log_value, student_quantile(effective - 1.0) * deviation, naive, effective)


def pooled_interval(log_value: float, records: Sequence[RecordDerivatives]) -> Interval:
    """Returns the interval of a value that is common to these records and to further records.

    All records have the same weight. The variance is the sandwich estimate with one cluster per
    record: it uses the spread of J.r/n between the records, where n is the number of samples.
    Student's quantile has len(records) - 1 degrees of freedom.
    """
    count = len(records)
    if count == 1:
        return record_interval(log_value, records[0])
    squares = sum((float(x.tangent @ x.residual) / len(x.residual)) ** 2 for x in records)
    quantile = student_quantile(count - 1.0)
    return _pooled(log_value, records, count / (count - 1) * squares, quantile)


def within_interval(log_value: float, records: Sequence[RecordDerivatives]) -> Interval:
    """Returns the interval of a value that is common to these records, but not to other records.

    The variance is the sum of the variances of all records, computed as in `record_interval`.
    """
    variance = sum(_score_variance(x) * correlation_time(x.residual) for x in records)
    quantile = student_quantile(_effective_samples(records) - 1.0)
    return _pooled(log_value, records, variance, quantile)


def _score_variance(x: RecordDerivatives) -> float:
    """Returns the variance of a record's score J.r/n if the n samples were independent."""
    return float(x.residual @ x.residual) * float(x.tangent @ x.tangent) / len(x.residual) ** 3


def _effective_samples(records: Sequence[RecordDerivatives]) -> float:
    return sum(max(len(x.residual) / correlation_time(x.residual), 2.0) for x in records)


def _pooled(
    log_value: float, records: Sequence[RecordDerivatives], variance: float, quantile: float
) -> Interval:
    """Returns the interval. `variance` is the variance of the sum of the records' scores J.r/n."""
    H = sum(x.curvature / len(x.residual) for x in records)
    JJ = sum(float(x.tangent @ x.tangent) / len(x.residual) for x in records)
    width = quantile * math.sqrt(variance) / H if H > 0.0 else math.inf
    spread = math.sqrt(sum(map(_score_variance, records)))
    naive = student_quantile(1e9) * spread / JJ if JJ else math.inf
    return _around(log_value, width, naive, _effective_samples(records))


def _around(log_value: float, width: float, naive: float, effective: float) -> Interval:
    bounded = min(width, 50.0)
    low, value, high = (math.exp(log_value + side * bounded) for side in (-1.0, 0.0, 1.0))
    widening = width / naive if 0.0 < naive < math.inf else math.nan
    return Interval(value, low, high, effective, widening)


def noise_floor(values: np.ndarray, order: int = 4) -> float:
    """Returns the standard deviation of the white noise in `values` (n,).

    Differences of the given order cancel a signal that is smooth over a few samples, and multiply
    the variance of white noise by binomial(2 order, order).
    """
    d = np.diff(values, order)
    return float(np.sqrt(np.mean(d**2) / math.comb(2 * order, order)))
