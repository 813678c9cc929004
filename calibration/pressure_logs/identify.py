"""Identifies the time constant k of the pressure lag from logs, with confidence intervals."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.inference.intervals import (
    Interval,
    RecordDerivatives,
    pooled_interval,
    record_interval,
    within_interval,
)
from calibration.pressure_logs.lag import PLAUSIBLE, LogBatch, fit_each, fit_pooled, residuals_at
from calibration.pressure_logs.read import ManifoldLog, psi
from calibration.pressure_logs.residual_shape import ResidualShape, shape_of, whole_cycles
from slider_jax.errors import InputError

PAPER_K = 0.087
"""Time constant k [s] of the paper's rig."""


def rms(values: np.ndarray) -> float:
    """Returns the root mean square of `values`."""
    return float(np.sqrt(np.mean(np.square(values))))


@dataclass(frozen=True)
class LogResult:
    """One log and its fitted k. Residuals (samples,) [psi] are measured - simulated pressure."""

    log: ManifoldLog
    k: Interval
    converged: bool
    before: np.ndarray
    """Residual with the paper's k."""
    after: np.ndarray
    """Residual with the k fitted to this log."""
    pooled: np.ndarray
    """Residual with the common k of all logs."""
    shape: ResidualShape
    """Statistics of the residual `after`."""

    @property
    def fixed(self) -> bool:
        """Whether this log determines k, and k is inside the search range."""
        return self.converged and self.k.fixed and PLAUSIBLE[0] < self.k.value < PLAUSIBLE[1]

    @property
    def rms_held(self) -> float:
        """RMSE [psi] of a prediction that the pressure stays constant at the log's first sample."""
        measured = psi(self.log.pressure)
        return rms(measured - measured[0])


@dataclass(frozen=True)
class Identification:
    """All logs and their common k."""

    logs: tuple[LogResult, ...]
    k: Interval
    """Common k. The interval includes the spread between logs, and also holds for further logs."""
    within: Interval
    """Common k. The interval holds for these logs only."""

    def pooled_rmse(self, which: str, settled: bool = False) -> float:
        """Returns the root of the mean of all logs' mean squares [psi]; logs have equal weights.

        `which` is the residual `before`, `after` or `pooled`. `settled` uses `whole_cycles` only.
        """
        pairs = [(getattr(x, which), x.log) for x in self.logs]
        values = [r[whole_cycles(log)] if settled else r for r, log in pairs]
        return math.sqrt(np.mean([rms(r) ** 2 for r in values]))

    def sample_rmse(self, which: str) -> float:
        """Returns the rms residual [psi] of all samples of all logs; samples have equal weights."""
        return rms(np.concatenate([getattr(x, which) for x in self.logs]))

    @property
    def floor(self) -> float:
        """Standard deviation [psi] of the sensor's white noise; logs have equal weights."""
        return rms(np.array([x.shape.floor for x in self.logs]))


def identify_lag(logs: Sequence[ManifoldLog]) -> Identification:
    """Fits the lag to every log, and to all logs together.

    Raises `InputError` if all logs together do not determine k.
    """
    batch = LogBatch.of(logs)
    each = fit_each(batch)
    common = fit_pooled(batch) if len(logs) > 1 else each
    before = np.asarray(residuals_at(PAPER_K, batch))
    counts = [len(log.t) for log in logs]
    own, shared = _evidence(each, counts), _evidence(common, counts)
    log_k = float(np.ravel(common.log_k)[0])
    k, within = pooled_interval(log_k, shared), within_interval(log_k, shared)
    if not (bool(np.all(common.converged)) and within.fixed):
        raise InputError(
            f"{', '.join(log.path.name for log in logs)}: these logs do not determine the lag k "
            f"(95 % interval {within.low:.3g} to {within.high:.3g} s; allowed: upper end less than "
            "10 times the lower end); give logs with larger pressure, more cycles or frequencies"
        )
    results = [
        LogResult(
            log=log,
            k=record_interval(float(each.log_k[i]), own[i]),
            converged=bool(each.converged[i]),
            before=before[i, :n],
            after=own[i].residual,
            pooled=shared[i].residual,
            shape=shape_of(log, own[i].residual),
        )
        for i, (log, n) in enumerate(zip(logs, counts, strict=True))
    ]
    return Identification(tuple(results), k, within)


def _evidence(fit, counts: Sequence[int]) -> list[RecordDerivatives]:
    residual, tangent, H = (np.asarray(x) for x in (fit.residual, fit.tangent, fit.curvature))
    return [
        RecordDerivatives(residual[i, :n], tangent[i, :n], float(H[i]))
        for i, n in enumerate(counts)
    ]
