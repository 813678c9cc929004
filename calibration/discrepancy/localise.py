"""Finds the channel, trial, setting, phase of the stride and frequency of a large residual."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from calibration.inference.goodness import Excess
from calibration.measurements.records import Record

TREND_P = 0.05
"""Probability that noise alone causes at least one of the reported trends (Bonferroni)."""
PHASES = 8
"""Number of equal parts of a stride in which the squared residual is averaged."""


def locate_residuals(
    records: Sequence[Record],
    predicted: Sequence[np.ndarray],
    left: dict[str, Excess],
    noise_floor: float,
) -> list[dict[str, Any]]:
    """Returns a record for each channel with a residual above the noise floor or with a pattern.

    `predicted` are the readings (channels, samples) of every trial of `records`. `left` contains
    the mean squares of the whitened residual of every channel. The worst trial is the trial with
    the largest mean square. If the mean square of the channel is at the noise floor, the worst
    trial is the first trial with a pattern.
    """
    found, level = [], TREND_P / (3 * max(len(left), 1))
    for channel, x in left.items():
        if not x.above(noise_floor):
            continue
        row, worst = records[0].row(channel), int(np.nanargmax(x.trials))
        trials = [r.trial for r in records]
        if x.all <= noise_floor:
            worst = [t.file for t in trials].index(x.patterns[0].trial)
        found.append(
            {
                "channel": channel,
                "mean_square_over_noise": x.all,
                "worst_trial": trials[worst].file,
                "frequency_Hz": trials[worst].frequency,
                "amplitude_Pa": trials[worst].amplitude,
                "tow_speed_m_per_s": trials[worst].tow_speed,
                "in_worst_trial": residual_timing(records[worst], channel, predicted[worst][row]),
                "grows_with": {
                    "frequency": significant_trend([t.frequency for t in trials], x.trials, level),
                    "amplitude": significant_trend([t.amplitude for t in trials], x.trials, level),
                    "tow_speed": significant_trend(
                        [abs(t.tow_speed) for t in trials], x.trials, level
                    ),
                },
                "trials": {t.file: s for t, s in zip(trials, x.trials, strict=True)},
            }
        )
    return found


def residual_timing(record: Record, channel: str, model: np.ndarray) -> dict[str, Any]:
    """Returns when in a trial the residual of a channel is largest.

    `phase` is the eighth of the drive's period with the largest mean squared residual. `share` is
    this mean square divided by the sum of all eight. `growing` is the fraction of the squared
    residual at times when the predicted reading moves away from its mean. `mean` is the residual's
    mean divided by its rms. `peak_Hz` is the frequency of the sine that explains most of the
    residual after subtraction of the mean. `peak_share` is the fraction of the sum of squares that
    this sine explains.
    """
    there = record.there(channel)
    r = (record.values[record.row(channel)] - model)[there]
    square = r**2 / max(float(np.sum(r**2)), 1e-300)
    away = (model - model.mean()) * np.gradient(model) > 0.0
    timing = {
        "growing": float(square[away[there]].sum()),
        "mean": float(r.mean() / np.sqrt(max(float(np.mean(r**2)), 1e-300))),
    } | _strongest(record.t[there], r)
    if record.trial.frequency is None:
        return timing
    part = np.floor(PHASES * ((record.t[there] * record.trial.frequency) % 1.0)).astype(int)
    count = np.bincount(part, minlength=PHASES)
    shares = np.bincount(part, square, minlength=PHASES)
    even = np.divide(shares, count, out=np.zeros(PHASES), where=count > 0)
    peak = int(np.argmax(even))
    span = [peak / PHASES, (peak + 1) / PHASES]
    return timing | {"phase": span, "share": float(even[peak] / max(even.sum(), 1e-300))}


def _strongest(t: np.ndarray, r: np.ndarray) -> dict[str, float]:
    """Returns `peak_Hz` and `peak_share` of `residual_timing` for the residual r at the times t."""
    even = np.arange(t[0], t[-1], float(np.median(np.diff(t))))
    y = np.interp(even, t, r - r.mean())
    power = np.abs(np.fft.rfft(y, 4 * len(y)))[1:] ** 2
    peak = int(np.argmax(power))
    hertz = np.fft.rfftfreq(4 * len(y), even[1] - even[0])[1:]
    share = 2.0 * power[peak] / max(len(y) * float(y @ y), 1e-300)
    return {"peak_Hz": float(hertz[peak]), "peak_share": min(float(share), 1.0)}


def significant_trend(
    settings: Sequence[float | None], squares: np.ndarray, level: float = TREND_P
) -> float | None:
    """Returns the rank correlation of the trials' mean squares with one of the trials' settings.

    Returns None for fewer than five trials or a p-value of `level` or more. The n trials have n!
    possible orders, and two of these orders have the correlation 1 or -1. The p-value is therefore
    at least 2/n!.
    """
    x = np.array([np.nan if s is None else s for s in settings], float)
    there = np.isfinite(x) & np.isfinite(squares)
    if there.sum() < 5 or np.ptp(x[there]) == 0.0 or np.ptp(squares[there]) == 0.0:
        return None
    found = spearmanr(x[there], squares[there])
    p = max(float(found.pvalue), 2.0 / math.factorial(int(there.sum())))
    return float(found.statistic) if p < level else None


def residual_text(x: dict[str, Any]) -> str:
    """Returns one entry of `locate_residuals` as a sentence."""
    text = f"{x['channel']}: mean square {x['mean_square_over_noise']:.3g} times the noise floor"
    here = x["in_worst_trial"]
    worst = f"worst in {x['worst_trial']}"
    settings = [
        f"{x['frequency_Hz']:g} Hz" if x["frequency_Hz"] else "",
        f"{x['amplitude_Pa'] / 1e3:g} kPa" if x["amplitude_Pa"] else "",
        f"towed at {x['tow_speed_m_per_s']:g} m/s" if x["tow_speed_m_per_s"] else "",
    ]
    if any(settings):
        worst += f" ({', '.join(s for s in settings if s)})"
    text += f", {worst}"
    if "phase" in here:
        low, high = here["phase"]
        text += f", largest at {low:.3g} to {high:.3g} of the stride"
    text += f"; a sine of {here['peak_Hz']:.3g} Hz explains {here['peak_share']:.0%} of the squares"
    text += f"; {here['growing']:.0%} of the squares are added while the prediction leaves its mean"
    for name, rank in x["grows_with"].items():
        if rank is not None:
            word = "grows" if rank > 0 else "falls"
            text += f"; {word} with {name.replace('_', ' ')}"
    return text + "."
