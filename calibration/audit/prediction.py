"""Finds wrong columns, units and signs of forces and tip, and outlier trials.

The audit compares the readings with the starting model's prediction. An inaccurate prediction is
sufficient: a wrong unit, a wrong sign or swapped columns are evident without exact parameters.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from calibration.audit.drive_response import rows_of_body, trial_finding
from calibration.audit.lag_response import MAX_SAMPLES, leave_one_out
from calibration.measurements.records import Finding, Record
from slider_jax.experiment.schema import Trial

LAGS = np.arange(-0.03, 0.1, 0.01)
"""Candidate delays of a sensor [s]. A delay that is the same in all trials is no fault."""
CLEAR = 0.8
"""A channel is identified only if its absolute correlation with the prediction exceeds this
value."""
COMPARABLE = 0.7
"""A channel is checked only if its correlation in the other trials is at least this value."""
MARGIN = 0.5
"""Columns are swapped if an exchange raises the sum of correlations by more than this value."""
STRANGE = 0.4
"""A channel of a trial is masked if its correlation is below this value at every delay."""
UNIT_MARGIN = np.log10(3.0)
"""A unit is wrong if log10(measured/predicted size) differs from 3 or -3 by less than this."""
PREFIXES = {1e3: "m", 1e-3: "k"}
"""Prefixes of wrong units. Each key is the value of 1 SI unit in the unit with the prefix."""
OUTLIER = 30.0
"""A trial is an outlier only if its mean square residual is more than this many times the median of
the other trials."""
BEYOND = 4.0
"""The mean square residual of an outlier must also be more than this many times the largest value
in all other trials."""


@dataclass(frozen=True)
class _Correlations:
    """Records with predicted readings (channels, n) of all channels except the pressures."""

    pairs: list[tuple[Record, np.ndarray]]
    rows: list[int]
    """Rows of the channels in the readings."""
    lags: list[float]
    """Delay [s] of each channel."""

    def name(self, row: int) -> str:
        return list(self.pairs[0][0].channels)[row]

    def correlation(self, i: int, column: int, row: int) -> float:
        """Returns the correlation of a measured column with a predicted row, delayed by `lags`."""
        r, p = self.pairs[i]
        return _correlation(r, p, column, row, self.lags[self.rows.index(row)])

    def own(self) -> np.ndarray:
        """Returns the correlation (trials, channels) of each channel with its prediction."""
        return np.array([[self.correlation(i, x, x) for x in self.rows] for i in self.trials])

    @property
    def trials(self) -> range:
        return range(len(self.pairs))

    def size(self, i: int, row: int) -> float:
        """Returns log10 of the ratio of the measured to the predicted standard deviation."""
        r, p = self.pairs[i]
        there = np.isfinite(r.values[row]) & np.isfinite(p[row])
        if there.sum() < 20 or not np.std(p[row, there]) or not np.std(r.values[row, there]):
            return float("nan")
        return float(np.log10(np.std(r.values[row, there]) / np.std(p[row, there])))


def _common_lag(pairs: Sequence[tuple[Record, np.ndarray]], rows: Sequence[int], row: int) -> float:
    """Returns the delay [s] at which a predicted row correlates best with the measured columns."""
    table = [
        [max(abs(_correlation(r, p, c, row, x)) for c in rows) for x in LAGS] for r, p in pairs
    ]
    return float(LAGS[np.argmax(np.median(table, axis=0))]) if table else 0.0


def _correlation(r: Record, p: np.ndarray, column: int, row: int, lag: float) -> float:
    there = np.flatnonzero(np.isfinite(r.values[column]))
    there = there[:: max(1, len(there) // MAX_SAMPLES)]
    y, x = r.values[column, there], np.interp(r.t[there] - lag, r.t, p[row])
    known = np.isfinite(x)
    if known.sum() < 20:
        return 0.0
    y, x = y[known] - y[known].mean(), x[known] - x[known].mean()
    size = float((y @ y) * (x @ x))
    return float(y @ x) / np.sqrt(size) if size > 0.0 else 0.0


def check_predicted_channels(
    records: Sequence[Record], predicted: Sequence[np.ndarray]
) -> tuple[list[Record], list[Finding]]:
    """Returns the records with unambiguous faults of forces and tip repaired, and findings.

    `predicted` contains the starting model's readings (channels, n) of every record. A channel that
    correlates with its prediction in all trials except one is masked in that one trial.
    """
    found, findings = list(records), []
    rows, pairs = rows_of_body(found[0].channels), [*zip(found, predicted, strict=True)]
    lags = [_common_lag(pairs, rows, row) for row in rows]
    for step in (_columns, _signs, _units, _strange_channels):
        found, more = step(_Correlations([*zip(found, predicted, strict=True)], rows, lags))
        findings += more
    return found, findings


def _columns(of: _Correlations) -> tuple[list[Record], list[Finding]]:
    tables = [
        np.array([[abs(of.correlation(i, c, row)) for row in of.rows] for c in of.rows])
        for i in of.trials
    ]
    straight = list(range(len(of.rows)))
    usual = _order(np.median(tables, axis=0)) if len(tables) > 2 else straight
    kept, findings = [], []
    for (r, _), C in zip(of.pairs, tables, strict=True):
        best = _order(C)
        if usual != straight and _total(C, usual) > _total(C, straight):
            best = usual
        moved = [x for x, c in enumerate(best) if c != x]
        clear = all(C[best[x], x] > CLEAR and C[x, x] < 0.7 * C[best[x], x] for x in moved)
        if not moved or not (clear or best == usual):
            kept.append(r)
            continue
        names = [of.name(of.rows[x]) for x in moved]
        columns = " and ".join(r.channels[x].column for x in names)
        detail = f"the columns {columns} are swapped: each column fits another channel's prediction"
        findings.append(trial_finding(r, "swapped_columns", ", ".join(names), detail, "mended"))
        values = r.values.copy()
        values[of.rows] = r.values[[of.rows[c] for c in best]]
        kept.append(replace(r, values=values))
    return kept, findings


def _order(C: np.ndarray) -> list[int]:
    """Returns the column of each channel, from the correlations `C` (columns, channels).

    Another order than the file's must raise the sum of correlations by more than `MARGIN`.
    """
    best, straight = linear_sum_assignment(C.T, maximize=True)[1].tolist(), list(range(len(C)))
    return best if _total(C, best) > _total(C, straight) + MARGIN else straight


def _total(C: np.ndarray, order: Sequence[int]) -> float:
    return float(sum(C[c, x] for x, c in enumerate(order)))


def _signs(of: _Correlations) -> tuple[list[Record], list[Finding]]:
    kept, findings = [], []
    table = of.own()
    known = np.min(np.abs(table), axis=0, initial=1.0) > COMPARABLE
    for (r, _), row in zip(of.pairs, table, strict=True):
        values = r.values.copy()
        for channel, value, sure in zip(of.rows, row, known, strict=True):
            if value > -CLEAR or not sure:
                continue
            name = of.name(channel)
            column = r.channels[name].column
            detail = f"{column} has the wrong sign (correlation {value:.2f}); the sign was inverted"
            findings.append(trial_finding(r, "sign", name, detail, "mended"))
            values[channel] *= -1.0
        kept.append(replace(r, values=values))
    return kept, findings


def _units(of: _Correlations) -> tuple[list[Record], list[Finding]]:
    sizes = np.array([[of.size(i, row) for row in of.rows] for i in of.trials])
    ordinary = np.abs(sizes) < 1.0
    kept, findings = [], []
    for i, (r, _) in enumerate(of.pairs):
        values = r.values.copy()
        for x, row in enumerate(of.rows):
            ratio = next(
                (f for f in PREFIXES if abs(sizes[i, x] - np.log10(f)) < UNIT_MARGIN), None
            )
            # A wrong model may also scale a channel. So a unit is wrong only if this channel has a
            # normal size in another trial, or another channel has a normal size in this trial.
            if ratio is None or not (ordinary[:, x].any() or ordinary[i].any()):
                continue
            name = of.name(row)
            unit, column = PREFIXES[ratio] + r.channels[name].unit, r.channels[name].column
            detail = (
                f"{column} is {10 ** sizes[i, x]:.3g} times its prediction: the numbers are in "
                f"{unit}, and were multiplied by {1.0 / ratio:g}"
            )
            findings.append(trial_finding(r, "units", name, detail, "mended"))
            values[row] /= ratio
        kept.append(replace(r, values=values))
    return kept, findings


def _strange_channels(of: _Correlations) -> tuple[list[Record], list[Finding]]:
    """Masks a channel in the only trial that the prediction does not fit, and adds a finding."""
    table = of.own()
    kept, findings = [], []
    for i, (r, p) in enumerate(of.pairs):
        values = r.values.copy()
        for x, row in enumerate(of.rows):
            rest, name = np.delete(table[:, x], i), of.name(row)
            if not r.has(name) or len(rest) < 3 or rest.min() < COMPARABLE:
                continue
            best = max(abs(_correlation(r, p, row, row, lag)) for lag in LAGS)
            if best < STRANGE:
                detail = (
                    f"the correlation of {r.channels[name].column} with its prediction is at most "
                    f"{best:.2f}, but {rest.min():.2f} or more in other trials; the channel is "
                    "masked"
                )
                findings.append(trial_finding(r, "strange_channel", name, detail, "masked"))
                values[row] = np.nan
        kept.append(replace(r, values=values))
    return kept, findings


def residual_outliers(
    trials: Sequence[Trial], mean_squares: Mapping[str, np.ndarray]
) -> list[Finding]:
    """Returns findings on trials whose residual is far larger than in all other trials.

    `mean_squares` maps a channel to the mean square (n,) of the whitened residual in each trial
    after the last fit. NaN marks trials without the channel. Trends with frequency, amplitude and
    tow speed may be physical, and are removed. A channel is checked only with five or more trials.
    """
    found = []
    slow = [abs(t.tow_speed) for t in trials]
    span = max(np.ptp(slow), 1e-9)
    x = np.array(
        [
            [np.log(t.frequency or 1.0), np.log(t.amplitude or 1.0), s / span]
            for t, s in zip(trials, slow, strict=True)
        ]
    )
    for i, trial in enumerate(trials):
        worst = 1.0, ""
        for channel, squares in mean_squares.items():
            there = np.isfinite(squares)
            if not there[i] or there.sum() < 5:
                continue
            others = np.maximum(np.delete(squares, i)[np.delete(there, i)], 1.0)
            ratio = float(squares[i] / np.median(others))
            y = np.log(np.maximum(squares[there], 1.0))
            slopes = np.array([1.0, 1.0, 2.0])
            deviations = leave_one_out(y, (x - x.mean(axis=0))[there], slopes, 0.3)
            off, error = deviations[int(there[:i].sum())]
            far = ratio > OUTLIER and squares[i] > BEYOND * others.max()
            if far and off > 3.0 * error and ratio > worst[0]:
                worst = ratio, channel
        if worst[1]:
            detail = (
                f"the residual's mean square in {worst[1]} is {worst[0]:.0f} times the median of "
                "the other trials, and no effect explains the residual: check the trial's "
                "settings, or repeat the trial"
            )
            found.append(Finding(trial.file, "outlier", worst[1], None, None, detail, "left out"))
    return found
