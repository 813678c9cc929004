"""Checks times of a trial (unit, order, repeats, gaps) and puts the rows on a regular grid."""

from collections import Counter

import numpy as np

from calibration.audit.rows import Rows, Unusable
from calibration.measurements.records import Finding, true_runs
from slider_jax.experiment.schema import Trial

JITTER = 0.2
"""Largest rms deviation of time stamps from a regular grid, as a fraction of the spacing."""
MAX_CONFLICTS = 0.02
"""Largest accepted fraction of rows that have another row's time but different readings."""
MANY_GAPS = 20
"""If a file has more gaps than this, one finding describes all gaps of the file."""
OFTEN = 0.4
"""The check for repeated rows omits channels that repeat at least this fraction of readings."""
FROZEN = 5
"""Fewer successive repeated rows never count as a stuck logger."""


def regular_rows(rows: Rows, trial: Trial) -> tuple[Rows, list[Finding]]:
    """Returns rows at increasing, nearly regular times, and findings.

    Missing rows are NaN. Raises `Unusable` if the times are inconsistent.
    """
    findings: list[Finding] = []
    for step in (_unit, _doubled, _stale, _sorted, _gaps):
        rows, more = step(rows, trial)
        findings += more
    return rows, findings


def _unit(rows: Rows, trial: Trial) -> tuple[Rows, list[Finding]]:
    """Returns the rows with times in s. The trial's duration identifies the unit in the file."""
    longest = float(np.median(np.sort(rows.t)[-3:]))
    for factor, unit in ((1e3, "milliseconds"), (1e6, "microseconds")):
        if 0.5 < longest / (factor * trial.duration) < 1.2:
            detail = (
                f"t_s ends at {longest:g}, but the trial lasts {trial.duration:g} s: the times are "
                f"in {unit} and were divided by {factor:g}"
            )
            found = Finding(trial.file, "units", "t_s", None, None, detail, "mended")
            return rows._replace(t=rows.t / factor), [found]
    if longest > 20.0 * trial.duration:
        detail = f"t_s ends at {longest:g}, but the trial lasts {trial.duration:g} s"
        raise Unusable(trial.file, "units", detail, "t_s")
    return rows, []


def _doubled(rows: Rows, trial: Trial) -> tuple[Rows, list[Finding]]:
    """Returns the rows without exact copies of rows, and findings."""
    findings = []
    table = np.concatenate([rows.t[None], np.nan_to_num(rows.values, nan=-7e77)])
    first = {column.tobytes(): i for i, column in reversed([*enumerate(table.T)])}
    keep = np.isin(np.arange(len(rows.t)), [*first.values()])
    if not keep.all():
        at = rows.t[~keep]
        detail = f"{np.sum(~keep)} copies of rows, from {at.min():.4g} s on, were dropped"
        span = float(at.min()), float(at.max())
        findings.append(Finding(trial.file, "doubled_rows", None, *span, detail, "mended"))
        rows = rows._replace(t=rows.t[keep], values=rows.values[:, keep])
    return rows, findings


def _stale(rows: Rows, trial: Trial) -> tuple[Rows, list[Finding]]:
    """Returns the rows, with NaN where a row repeats the previous readings of noisy sensors."""
    same = np.diff(rows.values, axis=1) == 0.0
    # A sensor that is stuck or at the end of its range repeats readings in correct rows too.
    repeated = same & (same.mean(axis=1) < OFTEN)[:, None]
    forces = repeated[rows.channels.rows(("thrust", "recoil"))].all(axis=0)
    stale = np.r_[False, forces & (repeated.sum(axis=0) >= 3)]
    if not stale.any():
        return rows, []
    at, values = rows.t[stale], rows.values.copy()
    values[:, stale] = np.nan
    frozen = max(b - a + 1 for a, b in true_runs(stale)) >= FROZEN
    detail = (
        f"{stale.sum()} rows repeat the readings of the previous row"
        f"{' in all sensors' if frozen else ''}, and count as missing"
    )
    span = float(at.min()), float(at.max())
    kind = "stuck" if frozen else "doubled_rows"
    found = Finding(trial.file, kind, None, *span, detail, "masked")
    return rows._replace(values=values), [found]


def _sorted(rows: Rows, trial: Trial) -> tuple[Rows, list[Finding]]:
    """Returns the rows in order of time, without rows with equal times and different readings."""
    findings = []
    back = np.flatnonzero(np.diff(rows.t) < 0.0)
    if back.size:
        order = np.argsort(rows.t, kind="stable")
        at = float(rows.t[back[0] + 1])
        detail = (
            f"the time decreases at {back.size} rows (first: {at:.4g} s); the rows were sorted "
            "by time"
        )
        findings.append(Finding(trial.file, "unsorted", "t_s", at, None, detail, "mended"))
        rows = rows._replace(t=rows.t[order], values=rows.values[:, order])
    same = np.flatnonzero(np.diff(rows.t) == 0.0)
    if not same.size:
        return rows, findings
    conflicts = np.unique(np.r_[same, same + 1])
    if len(conflicts) > max(4.0, MAX_CONFLICTS * len(rows.t)):
        detail = (
            f"{len(conflicts)} rows have equal times and different readings: the clock was reset, "
            "or the file contains two runs"
        )
        raise Unusable(trial.file, "unsorted", detail, "t_s")
    span = float(rows.t[same[0]]), float(rows.t[same[-1]])
    detail = f"{len(conflicts)} rows have equal times and different readings and were dropped"
    findings.append(Finding(trial.file, "doubled_rows", None, *span, detail, "masked"))
    keep = np.setdiff1d(np.arange(len(rows.t)), conflicts)
    return rows._replace(t=rows.t[keep], values=rows.values[:, keep]), findings


def _gaps(rows: Rows, trial: Trial) -> tuple[Rows, list[Finding]]:
    """Returns the rows on the regular grid that fits their times, with NaN for missing rows."""
    t, apart = rows.t, np.diff(rows.t)
    short = float(np.quantile(apart, 0.1))
    dt = float(np.median(apart[(apart > 0.75 * short) & (apart < 1.25 * short)]))
    steps = np.maximum(np.round(apart / dt).astype(int), 1)
    index = np.r_[0, np.cumsum(steps)]
    if index[-1] > 20 * len(t):
        at = float(t[np.argmax(steps)])
        detail = f"rows are {dt:.4g} s apart, but a gap of {apart.max():.4g} s begins at {at:.4g} s"
        raise Unusable(trial.file, "gap", detail, "t_s", (at, at + float(apart.max())))
    slope, first = np.polyfit(index, t, 1)
    jitter = float(np.sqrt(np.mean((t - first - slope * index) ** 2))) / slope
    if jitter > JITTER:
        common = [f"{1.0 / s:.4g}" for s, _ in Counter(np.round(apart, 5)).most_common(2) if s]
        detail = (
            f"the time stamps are irregular: they deviate by {jitter:.2g} spacings (rms) from a "
            f"regular grid; the most frequent rates are {' and '.join(common)} Hz"
        )
        raise Unusable(trial.file, "sample_rate", detail, "t_s")
    there = np.zeros(index[-1] + 1, bool)
    there[index] = True
    times = first + slope * np.arange(len(there))
    times[there] = t
    values = np.full((len(rows.values), len(there)), np.nan)
    values[:, there] = rows.values
    return rows._replace(t=times, values=values), _gap_findings(trial, times, there, float(slope))


def _gap_findings(trial: Trial, t: np.ndarray, there: np.ndarray, dt: float) -> list[Finding]:
    runs = true_runs(~there)
    if len(runs) > MANY_GAPS:
        detail = (
            f"{np.sum(~there)} of {len(there)} rows at {1.0 / dt:.4g} Hz are missing, in "
            f"{len(runs)} gaps: rows were lost, or the rate changed; the other rows are used"
        )
        span = float(t[runs[0][0]]), float(t[runs[-1][1]])
        kind = "sample_rate" if np.mean(~there) > 0.2 else "gap"
        return [Finding(trial.file, kind, None, *span, detail, "used")]
    spans = [(float(t[a - 1]), float(t[b + 1]), b - a + 1) for a, b in runs]
    # A skewed clock shifts the end by up to 3 %. `check_clocks` reports this fault.
    margin = max(5.0 * dt, 0.035 * trial.duration)
    if t[0] > margin:
        spans.insert(0, (0.0, float(t[0]), int(t[0] / dt)))
    if trial.duration - t[-1] > margin:
        spans.append((float(t[-1]), trial.duration, int((trial.duration - t[-1]) / dt)))
    return [
        Finding(trial.file, "gap", None, a, b,
                f"{n} rows are missing between {a:.4g} and {b:.4g} s; other rows are used", "used")
        for a, b, n in spans
    ]  # fmt: skip
