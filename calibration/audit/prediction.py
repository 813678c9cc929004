"""Forces and tip against a prediction: columns, units and signs; and trials that stand apart.

The prediction is that of the starting model. It need not be good: a thousandfold unit, a sign or a
pair of exchanged columns show long before the parameters are known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from calibration.audit.drive_response import NAMES
from calibration.audit.lag_response import MOST_SAMPLES, surprise
from calibration.measurements.findings import Finding
from calibration.measurements.records import Record
from slider_jax.channels import BUILT_IN
from slider_jax.experiment.schema import Trial

BODY = (2, 3, 4)
"""Rows of thrust, recoil and tip."""
LAGS = np.arange(-0.03, 0.1, 0.01)
"""By which a sensor's clock or a camera may be late [s]: physics, common to all trials."""
CLEAR = 0.8
"""Correlation with the prediction from which on a channel is known by it."""
ALIKE = 0.7
"""Correlation that all other trials must reach for one trial to be judged by it."""
MARGIN = 0.5
"""By which correlations must be better together for columns to be called swapped."""
STRANGE = 0.4
"""Largest correlation at any delay of a channel that resembles nothing."""
WITHIN = np.log10(3.0)
"""How far a size may lie from a thousandfold of the prediction's, in decades."""
SMALL = {1e3: ("mN", "mN", "mm"), 1e-3: ("kN", "kN", "km")}
OUTLIER = 30.0
"""Times by which a trial's mean square must exceed the others' median to be called corrupt."""
BEYOND = 4.0
"""And the largest of the others'."""


class _Likeness:
    """Correlations and sizes of measured channels against predicted ones, all trials."""

    def __init__(
        self,
        records: Sequence[Record],
        predicted: Sequence[np.ndarray],
        lags: Sequence[float] | None = None,
    ):
        self.pairs = list(zip(records, predicted, strict=True))
        self.lags = [self._common_lag(row) for row in BODY] if lags is None else list(lags)

    def _common_lag(self, row: int) -> float:
        """The delay [s] behind a channel's prediction that suits most trials, in any column."""
        table = [
            [max(abs(_correlation(r, p, c, row, x)) for c in BODY) for x in LAGS]
            for r, p in self.pairs
        ]
        return float(LAGS[np.argmax(np.median(table, axis=0))]) if table else 0.0

    def correlation(self, i: int, column: int, row: int) -> float:
        """Of a column of trial i with the prediction of a row, at that row's delay."""
        r, p = self.pairs[i]
        return _correlation(r, p, column, row, self.lags[BODY.index(row)])

    def size(self, i: int, row: int) -> float:
        """Decades by which the measured channel's rms exceeds the predicted one's."""
        r, p = self.pairs[i]
        there = np.isfinite(r.values[row]) & np.isfinite(p[row])
        if there.sum() < 20 or not np.std(p[row, there]) or not np.std(r.values[row, there]):
            return float("nan")
        return float(np.log10(np.std(r.values[row, there]) / np.std(p[row, there])))


def _correlation(r: Record, p: np.ndarray, column: int, row: int, lag: float) -> float:
    there = np.flatnonzero(np.isfinite(r.values[column]))
    there = there[:: max(1, len(there) // MOST_SAMPLES)]
    y, x = r.values[column, there], np.interp(r.t[there] - lag, r.t, p[row])
    known = np.isfinite(x)
    if known.sum() < 20:
        return 0.0
    y, x = y[known] - y[known].mean(), x[known] - x[known].mean()
    size = float((y @ y) * (x @ x))
    return float(y @ x) / np.sqrt(size) if size > 0.0 else 0.0


def against_model(
    records: Sequence[Record], predicted: Sequence[np.ndarray]
) -> tuple[list[Record], list[Finding]]:
    """Records with forces and tip mended where that is unambiguous, and findings.

    `predicted` are readings (5, n) of every record's trial by the starting model. A channel that
    resembles nothing, while it does in the other trials, is masked.
    """
    found, findings = list(records), []
    lags = _Likeness(found, predicted).lags
    for step in (_columns, _signs, _units, _strangers):
        found, more = step(_Likeness(found, predicted, lags))
        findings += more
    return found, findings


def _columns(like: _Likeness) -> tuple[list[Record], list[Finding]]:
    tables = [
        np.array([[abs(like.correlation(i, c, row)) for row in BODY] for c in BODY])
        for i in range(len(like.pairs))
    ]
    usual = _order(np.median(tables, axis=0)) if len(tables) > 2 else (0, 1, 2)
    kept, findings = [], []
    for (r, _), C in zip(like.pairs, tables, strict=True):
        best = _order(C)
        if usual != (0, 1, 2) and _total(C, usual) > _total(C, (0, 1, 2)):
            best = usual
        moved = [x for x, c in enumerate(best) if c != x]
        clear = all(C[best[x], x] > CLEAR and C[x, x] < 0.7 * C[best[x], x] for x in moved)
        if not moved or not (clear or best == usual):
            kept.append(r)
            continue
        rows = [0, 1, *(BODY[c] for c in best)]
        names = " and ".join(NAMES[BODY[x]] for x in moved)
        channels = ", ".join(BUILT_IN[BODY[x]] for x in moved)
        how = f"the columns {names} are swapped: each resembles the prediction of the other"
        findings.append(_finding(r, "swapped_columns", channels, how, "mended"))
        kept.append(replace(r, values=r.values[rows]))
    return kept, findings


def _order(C: np.ndarray) -> tuple[int, ...]:
    """The column of each channel that resembles its prediction best, by correlations (3, 3).

    That of the file, unless another is better by far.
    """

    best = max(permutations(range(3)), key=lambda order: _total(C, order))
    return best if _total(C, best) > _total(C, (0, 1, 2)) + MARGIN else (0, 1, 2)


def _total(C: np.ndarray, order: Sequence[int]) -> float:
    return float(sum(C[c, x] for x, c in enumerate(order)))


def _signs(like: _Likeness) -> tuple[list[Record], list[Finding]]:
    kept, findings = [], []
    table = [[like.correlation(i, x, x) for x in BODY] for i in range(len(like.pairs))]
    known = np.min(np.abs(table), axis=0, initial=1.0) > ALIKE
    for (r, _), row in zip(like.pairs, table, strict=True):
        values = r.values.copy()
        for channel, value, sure in zip(BODY, row, known, strict=True):
            if value > -CLEAR or not sure:
                continue
            name = NAMES[channel]
            how = f"{name} has its sign turned (correlation {value:.2f}); it was turned back"
            findings.append(_finding(r, "sign", BUILT_IN[channel], how, "mended"))
            values[channel] *= -1.0
        kept.append(replace(r, values=values))
    return kept, findings


def _units(like: _Likeness) -> tuple[list[Record], list[Finding]]:
    sizes = np.array([[like.size(i, row) for row in BODY] for i in range(len(like.pairs))])
    ordinary = np.abs(sizes) < 1.0
    kept, findings = [], []
    for i, (r, _) in enumerate(like.pairs):
        values = r.values.copy()
        for x, row in enumerate(BODY):
            ratio = next((f for f in SMALL if abs(sizes[i, x] - np.log10(f)) < WITHIN), None)
            # Another trial, or another channel of this one, must be of the predicted size.
            if ratio is None or not (ordinary[:, x].any() or ordinary[i].any()):
                continue
            unit, name = SMALL[ratio][x], NAMES[row]
            how = (
                f"{name} is {10 ** sizes[i, x]:.3g} times what the model predicts: it is in "
                f"{unit}, and was multiplied by {1.0 / ratio:g}"
            )
            findings.append(_finding(r, "units", BUILT_IN[row], how, "mended"))
            values[row] /= ratio
        kept.append(replace(r, values=values))
    return kept, findings


def _strangers(like: _Likeness) -> tuple[list[Record], list[Finding]]:
    """Channels that resemble nothing in one trial and their prediction in all others."""
    n = len(like.pairs)
    table = np.array([[like.correlation(i, x, x) for x in BODY] for i in range(n)]).reshape(n, 3)
    kept, findings = [], []
    for i, (r, p) in enumerate(like.pairs):
        values = r.values.copy()
        for x, row in enumerate(BODY):
            rest = np.delete(table[:, x], i)
            if not r.has(BUILT_IN[row]) or len(rest) < 3 or rest.min() < ALIKE:
                continue
            best = max(abs(_correlation(r, p, row, row, lag)) for lag in LAGS)
            if best < STRANGE:
                how = (
                    f"{NAMES[row]} does not resemble its prediction (correlation "
                    f"{best:.2f} at best, {rest.min():.2f} or more in the other trials); the "
                    "channel is not used in this trial"
                )
                findings.append(_finding(r, "strange_channel", BUILT_IN[row], how, "masked"))
                values[row] = np.nan
        kept.append(replace(r, values=values))
    return kept, findings


def outliers(trials: Sequence[Trial], mean_squares: Mapping[str, np.ndarray]) -> list[Finding]:
    """Trials whose residual stands so far above all others' that the trial itself is at fault.

    `mean_squares` are white mean squares (n,) of every channel, NaN where a trial lacks it, after
    the last fit: what an effect explains is no fault. A trend over frequency, amplitude or tow
    speed is physics: what one end of it does is not called corrupt. At least five trials.
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
        worst = 1.0, "", 0.0
        for channel, squares in mean_squares.items():
            there = np.isfinite(squares)
            if not there[i] or there.sum() < 5:
                continue
            others = np.maximum(np.delete(squares, i)[np.delete(there, i)], 1.0)
            ratio = float(squares[i] / np.median(others))
            y = np.log(np.maximum(squares[there], 1.0))
            told = surprise(y, (x - x.mean(axis=0))[there], np.array([1.0, 1.0, 2.0]), 0.3)
            off = told[int(there[:i].sum())]
            far = ratio > OUTLIER and squares[i] > BEYOND * others.max()
            if far and off.apart > 3.0 * off.error and ratio > worst[0]:
                worst = ratio, channel, float(squares[i])
        if worst[1]:
            how = (
                f"its residual in {worst[1]} is {worst[0]:.0f} times that of the other trials in "
                "mean square, and no effect explains it: its settings may not be those declared, "
                "or the run went wrong"
            )
            found.append(Finding(trial.file, "outlier", worst[1], None, None, how, "left out"))
    return found


def _finding(r: Record, kind: str, channel: str, how: str, action) -> Finding:
    return Finding(r.trial.file, kind, channel, float(r.t[0]), float(r.t[-1]), how, action)
