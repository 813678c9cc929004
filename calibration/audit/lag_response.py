"""Fits the response of a first-order lag, driven by the declared drive, to measured series.

Each fit has a free gain and a free slow drift. The audit uses one time constant and one delay for
all trials, so that a physical effect that all trials share does not count as a fault.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from slider_jax.experiment.drive import delays_of, ratios_of
from slider_jax.experiment.schema import Trial

TIME_CONSTANTS = np.geomspace(0.02, 0.5, 14)
"""Candidate time constants of the lag [s]."""
DELAYS = np.linspace(-0.01, 0.11, 13)
"""Candidate delays of the pressure behind the lag's response [s]."""
LONGEST_LEAD = 5.0
"""Largest considered time [s] of a drive before the trial's time 0. Every lag then has settled."""
SETTLED = 0.5
"""Time [s] after the drive's start. The phases of later cycles do not depend on the start."""
TWO_CYCLE_ERROR = 2e-3
"""Assumed standard error of a phase drift that is measured on two cycles [rad per cycle]."""
MAX_SAMPLES = 300
"""Approximate number of samples of a series that a fit uses. Longer series are thinned."""


class DeclaredDrive(NamedTuple):
    """Declared set pressure of a chamber: frequency [Hz], amplitude [Pa], phase, rise [periods].

    The set pressure is the wave plus the `bias` [Pa], limited to the range from `low` to `high`
    [Pa]. The drive starts `lead` [s] before the trial's time 0.
    """

    waveform: str
    frequency: float
    amplitude: float
    phase: float
    rise: float
    bias: float = 0.0
    low: float = -np.inf
    high: float = np.inf
    lead: float = 0.0

    @property
    def driven(self) -> bool:
        """Whether the set pressure changes."""
        return self.amplitude != 0.0

    @property
    def lag(self) -> float:
        """Phase of the fundamental [periods]: half a period more if the amplitude is negative."""
        return self.phase + (0.5 if self.amplitude < 0.0 else 0.0)

    def unit(self, t: np.ndarray) -> np.ndarray:
        """Returns the set pressure divided by its amplitude at `t` (n,) [s]; 0 before the start."""
        turn = self.frequency * t - self.phase
        if self.waveform == "sine":
            value = np.sin(2.0 * np.pi * turn)
        else:
            value = np.where(np.floor(2.0 * turn + 1e-9) % 2 == 0, 1.0, -1.0)
        if self.waveform == "trapezoid":
            from_edge = turn - np.round(2.0 * turn) / 2.0
            sign = np.where(np.round(2.0 * turn) % 2 == 0, 1.0, -1.0)
            value = sign * np.clip(from_edge / (0.5 * self.rise), -1.0, 1.0)
        limited = np.clip(self.amplitude * value + self.bias, self.low, self.high)
        return np.where(t < -self.lead, 0.0, limited / self.amplitude)


def declared_drives(
    trial: Trial, chambers: int, limits: Sequence[tuple[float, float]] | None = None
) -> tuple[DeclaredDrive, ...] | None:
    """Returns the drive of each chamber; None if all are zero, or if the drives are recorded.

    `limits` are the lowest and the highest set pressure [Pa] of each chamber (default: none).
    """
    f, amplitude = trial.frequency, trial.amplitude
    if trial.waveform == "recorded" or not f or not amplitude:
        return None
    ratios, phases = ratios_of(trial, chambers), delays_of(trial, chambers)
    each = zip(
        ratios,
        phases,
        trial.biases or [0.0] * chambers,
        limits or [(-np.inf, np.inf)] * chambers,
        strict=True,
    )
    lead = min(trial.lead, LONGEST_LEAD)
    drives = tuple(
        DeclaredDrive(trial.waveform, f, amplitude * ratio, phase, trial.rise, bias, *ends, lead)
        for ratio, phase, bias, ends in each
    )
    return drives if any(x.driven for x in drives) else None


def _lag_responses(
    drive: DeclaredDrive, duration: float, time_constants: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Returns times (n,) [s] and the lag's response (n,) to a unit drive for each time constant."""
    spacing = min(1e-3, 1.0 / (200.0 * drive.frequency))
    t = spacing * np.arange(int(np.ceil((duration + drive.lead) / spacing)) + 2) - drive.lead
    set_point, keep = drive.unit(t + 0.5 * spacing), np.exp(-spacing / time_constants)
    responses = [lfilter([1.0 - share], [1.0, -share], set_point)[:-1] for share in keep]
    return t, [np.r_[0.0, after] for after in responses]


class LagFits(NamedTuple):
    """Fits of m series with the lag's response to each drive, for all time constants and delays.

    `gain` is the signed ratio of a series to the response. `residual` is the fit residual's rms
    divided by the series' rms. Both arrays have the shape (m, chambers, time constants, delays).
    They are NaN for a chamber whose set pressure does not change.
    """

    gain: np.ndarray
    residual: np.ndarray


def _without_drift(t: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Returns `series` (..., n) at `t` (n,) minus a fitted parabola, which removes slow drift."""
    x = (t - t.mean()) / max(float(np.ptp(t)), 1e-300)
    Q = np.linalg.qr(np.stack([np.ones_like(x), x, x**2], axis=1))[0]
    return series - (series @ Q) @ Q.T


def fit_lags(
    t: np.ndarray,
    values: np.ndarray,
    chambers: Sequence[DeclaredDrive],
    delays: np.ndarray = DELAYS,
    time_constants: np.ndarray = TIME_CONSTANTS,
) -> LagFits:
    """Returns fits of the series `values` (m, n) at times `t` (n,) [s]. Missing values are NaN."""
    shape = (len(values), len(chambers), len(time_constants), len(delays))
    gain, residual = np.zeros(shape), np.ones(shape)
    every = max(1, len(t) // MAX_SAMPLES)
    for j, drive in enumerate(chambers):
        if not drive.driven:
            gain[:, j] = residual[:, j] = np.nan
            continue
        times, responses = _lag_responses(drive, float(t[-1]) + 0.02, time_constants)
        regressors: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}  # key: sample indices
        for i, series in enumerate(values):
            there = np.flatnonzero(np.isfinite(series))
            there = there[:: max(1, min(every, len(there) // 60))]
            if len(there) < 20 or np.ptp(series[there]) == 0.0:
                continue
            at, key = t[there], there.tobytes()
            if key not in regressors:
                shifted = at - delays[:, None]
                R = np.concatenate([np.interp(shifted, times, y) for y in responses])
                R = _without_drift(at, R)
                size = np.maximum(np.einsum("ij,ij->i", R, R), 1e-12 * len(at))
                regressors[key] = R, size
            R, size = regressors[key]
            m = _without_drift(at, series[there])
            along = R @ m
            gain[i, j] = (along / size / drive.amplitude).reshape(shape[2:])
            share = np.clip(1.0 - along**2 / size / max(float(m @ m), 1e-300), 0.0, 1.0)
            residual[i, j] = np.sqrt(share).reshape(shape[2:])
    return LagFits(gain, residual)


class PeriodRatio(NamedTuple):
    """Relative error of a frequency (positive: above the declared value) and its standard error."""

    off: float
    error: float


def period_ratio(t: np.ndarray, y: np.ndarray, frequency: float) -> PeriodRatio | None:
    """Returns the relative deviation of y's frequency from `frequency` [Hz]; None for < 2 cycles.

    The phase drift of the fundamental gives the deviation. A distortion that all cycles share,
    such as lag, delay or saturation, does not change the result. The first cycles are not used.
    """
    faster, found = 1.0, None
    for _ in range(3):
        found = _drift(t * faster, y, frequency)
        if found is None:
            return None
        faster *= 1.0 + found.off
    assert found is not None
    return PeriodRatio(faster - 1.0, found.error)


def _drift(t: np.ndarray, y: np.ndarray, frequency: float) -> PeriodRatio | None:
    last = int(np.floor(2.0 * (t[-1] * frequency + 0.02))) - 1
    first = min(max(1, int(np.ceil(2.0 * SETTLED * frequency))), max(last - 4, 1))
    spacing = float(np.median(np.diff(t)))
    phases, cycles = [], []
    for j in range(first, last):  # windows of one cycle, half a cycle apart
        inside = (t >= 0.5 * j / frequency) & (t < (0.5 * j + 1.0) / frequency)
        if inside.sum() * spacing * frequency < 0.9:
            continue
        turn = 2.0 * np.pi * frequency * t[inside]
        waves = [f(n * turn) for n in (1, 2, 3) for f in (np.cos, np.sin)]
        columns = np.stack([*waves, np.ones_like(turn), turn - turn.mean()], 1)
        a, b = np.linalg.lstsq(columns, y[inside])[0][:2]
        phases.append(np.arctan2(b, a))
        cycles.append(0.5 * j)
    if len(cycles) < 2:
        return None
    drift = np.unwrap(np.array(phases))
    x = np.array(cycles) - np.mean(cycles)
    slope = float(x @ drift) / float(x @ x)
    rest = drift - drift.mean() - slope * x
    free = max(len(x) - 2, 1)
    error = float(np.sqrt(rest @ rest / free / (x @ x))) if len(x) > 2 else TWO_CYCLE_ERROR
    return PeriodRatio(-slope / (2.0 * np.pi), error / (2.0 * np.pi))


def settling_time(t: np.ndarray) -> float:
    """Returns the time [s] after which a pressure counts as periodic, at most 30 % of the trial."""
    return min(SETTLED, 0.3 * float(t[-1]))


def fundamental_tone(t: np.ndarray, y: np.ndarray, frequency: float) -> tuple[float, float]:
    """Returns the amplitude and the lag (fraction of a period) of the fundamental of y (n,).

    The least-squares fit also includes two higher harmonics and a parabola.
    """
    late = t >= settling_time(t)
    turn = 2.0 * np.pi * frequency * t[late]
    waves = [f(n * turn) for n in (1, 2, 3) for f in (np.cos, np.sin)]
    x = turn / turn[-1]
    columns = np.stack([*waves, np.ones_like(x), x, x**2], axis=1)
    a, b = np.linalg.lstsq(columns, y[late])[0][:2]
    return float(np.hypot(a, b)), float(np.arctan2(b, a) / (2.0 * np.pi))


def leave_one_out(
    y: np.ndarray, x: np.ndarray, slopes: np.ndarray, floor: float
) -> list[tuple[float, float]]:
    """Returns, for each y (n,), the deviation from a fit to all other y, and its standard error.

    The fit is a plane with the variables `x` (n, p). `slopes` (p,) are prior standard deviations of
    the plane's slopes. `floor` is the smallest assumed scatter of y about the plane.
    """
    found = []
    for i in range(len(y)):
        rest = np.delete(np.arange(len(y)), i)
        centre = np.median(y[rest])
        scatter = max(float(np.median(np.abs(y[rest] - centre))) * 1.5, floor)
        for _ in range(2):
            A = np.column_stack([np.ones(len(rest)), x[rest]])
            prior = np.diag(np.r_[0.0, 1.0 / slopes**2])
            cov = np.linalg.inv(A.T @ A / scatter**2 + prior)
            plane = cov @ A.T @ y[rest] / scatter**2
            off = np.abs(y[rest] - A @ plane)
            scatter = max(1.5 * float(np.median(off)), floor)
        here = np.r_[1.0, x[i]]
        error = float(np.sqrt(here @ cov @ here + scatter**2))
        found.append((float(y[i] - here @ plane), error))
    return found
