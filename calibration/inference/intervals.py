"""How well data fix a parameter when the residual is correlated, and what noise is under it."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

CONFIDENCE = 0.95


class Interval(NamedTuple):
    """A positive parameter with its 95 % interval, and what the correlation did to it."""

    value: float
    low: float
    high: float
    effective: float
    """Effective number of samples."""
    widening: float
    """Width in the logarithm over that of the naive interval: every sample independent."""

    @property
    def fixed(self) -> bool:
        """Whether the data fix the value at all: within a factor of ten."""
        return self.high < 10.0 * self.low


class Evidence(NamedTuple):
    """What one record says of log x at the fit: r, J = dr/d(log x), H = d^2(r.r/2)/d(log x)^2."""

    residual: np.ndarray
    tangent: np.ndarray
    curvature: float


def correlation_time(residual: np.ndarray) -> float:
    """Samples per independent sample: 1 + 2 sum of the autocorrelation up to its first zero.

    Of the residual about its mean. What repeats every cycle is correlated for ever; this counts
    about four to six independent values in a cycle of it instead of its thousands of samples.
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


def student(freedom: float) -> float:
    """Two-sided Student quantile of `CONFIDENCE`."""
    return float(stdtrit(max(freedom, 1.0), 0.5 + 0.5 * CONFIDENCE))


def record_interval(log_value: float, evidence: Evidence) -> Interval:
    """Interval of a least-squares fit to one record.

    The sandwich s^2 tau J.J / H^2 in log x, with tau the residual's `correlation_time` and H the
    true curvature: where the model is wrong the residual is large and J.J alone is not that.
    """
    r, J, H = evidence
    n, time = len(r), correlation_time(r)
    effective = max(n / time, 2.0)
    s2, JJ = float(r @ r) / max(n - 1, 1), float(J @ J)
    naive = student(n - 1.0) * math.sqrt(s2 / JJ) if JJ else math.inf
    deviation = math.sqrt(s2 * time * JJ) / H if H > 0.0 else math.inf
    return _around(log_value, student(effective - 1.0) * deviation, naive, effective)


def pooled_interval(log_value: float, evidence: Sequence[Evidence]) -> Interval:
    """Interval of the value common to records that weigh the same, as a sample of such records.

    The sandwich with one cluster a record: the spread of their pulls J.r/n on the common value,
    Student with records - 1 degrees of freedom. With one record, that record's own interval.
    """
    records = len(evidence)
    if records == 1:
        return record_interval(log_value, evidence[0])
    pulls = sum((float(e.tangent @ e.residual) / len(e.residual)) ** 2 for e in evidence)
    return _pooled(log_value, evidence, records / (records - 1) * pulls, student(records - 1.0))


def within_interval(log_value: float, evidence: Sequence[Evidence]) -> Interval:
    """Interval of the value common to just these records: as `record_interval`, summed over them.

    Says nothing of how far another record would lie from these.
    """
    pulls = sum(_variance(e) * correlation_time(e.residual) for e in evidence)
    return _pooled(log_value, evidence, pulls, student(_effective(evidence) - 1.0))


def _variance(e: Evidence) -> float:
    """Of a record's pull J.r/n, were its samples independent."""
    return float(e.residual @ e.residual) * float(e.tangent @ e.tangent) / len(e.residual) ** 3


def _effective(evidence: Sequence[Evidence]) -> float:
    return sum(max(len(e.residual) / correlation_time(e.residual), 2.0) for e in evidence)


def _pooled(log_value: float, evidence: Sequence[Evidence], pulls: float, t: float) -> Interval:
    """The interval from the variance of the pulls' sum and its Student quantile."""
    H = sum(e.curvature / len(e.residual) for e in evidence)
    JJ = sum(float(e.tangent @ e.tangent) / len(e.residual) for e in evidence)
    width = t * math.sqrt(pulls) / H if H > 0.0 else math.inf
    naive = student(1e9) * math.sqrt(sum(map(_variance, evidence))) / JJ if JJ else math.inf
    return _around(log_value, width, naive, _effective(evidence))


def _around(log_value: float, width: float, naive: float, effective: float) -> Interval:
    bounded = min(width, 50.0)
    low, value, high = (math.exp(log_value + side * bounded) for side in (-1.0, 0.0, 1.0))
    widening = width / naive if 0.0 < naive < math.inf else math.nan
    return Interval(value, low, high, effective, widening)


def noise_floor(values: np.ndarray, order: int = 4) -> float:
    """Standard deviation of the white noise in `values`, from their differences of `order`.

    Differences cancel what is smooth over a few samples; white noise passes with the variance
    binomial(2 order, order).
    """
    d = np.diff(values, order)
    return float(np.sqrt(np.mean(d**2) / math.comb(2 * order, order)))
