"""Writes the sentences of the report on the identification of the pressure lag."""

import math

import numpy as np

from calibration.pressure_logs.identify import Identification, rms

MAX_NOISE_RATIO = 2.0
"""A lag explains the logs if its RMSE is at most this multiple of the sensor's white noise."""


def lag_verdict(found: Identification) -> str:
    """Returns a sentence that states whether a single lag explains all logs."""
    times = found.pooled_rmse("pooled") / found.floor
    one, these = ("One lag", "these logs") if len(found.logs) > 1 else ("A lag", "this log")
    does = "explains" if times <= MAX_NOISE_RATIO else "does not explain"
    return (
        f"{one} of {1e3 * found.k.value:.0f} ms {does} {these}: the rms residual is {times:.2g} "
        f"times the sensor's noise (limit: {MAX_NOISE_RATIO:g} times)."
    )


def describe_lag(found: Identification) -> list[str]:
    """Returns sentences on k and on the residual. The first sentence is `lag_verdict`."""
    k, n = found.k, len(found.logs)
    before, after = found.pooled_rmse("before"), found.pooled_rmse("pooled")
    own, floor = found.pooled_rmse("after"), found.floor
    text = [
        lag_verdict(found),
        f"One lag for all {n} logs: k = {1e3 * k.value:.0f} ms, 95 % interval {1e3 * k.low:.0f} to "
        f"{1e3 * k.high:.0f} ms ({'clustered by log' if n > 1 else 'for a correlated residual'}). "
        f"The interval is {k.widening:.0f} times as wide as for independent samples.",
        f"The RMSE is {before:.2f} psi with the paper's k, {after:.2f} psi with the common k, and "
        f"{own:.2f} psi with a separate k for each log; the sensor's noise is {floor:.2f} psi.",
    ]
    if not k.fixed:
        text.append(
            f"For these logs only, the interval of the common k is {1e3 * found.within.low:.0f} to "
            f"{1e3 * found.within.high:.0f} ms. The logs are too few, and differ too much, to "
            "predict the k of another log."
        )
    return text + _spread(found) + _residual(found)


def _spread(found: Identification) -> list[str]:
    fixed = [x for x in found.logs if x.fixed]
    loose = [x.log.path.name for x in found.logs if not x.fixed]
    text = []
    if loose:
        text.append(
            f"Alone, these logs do not determine k: {', '.join(loose)}. The interval of each "
            "log is too wide, or k is at a limit of the search."
        )
    if len(fixed) >= 2:
        low, high = (f(fixed, key=lambda x: x.k.value) for f in (min, max))
        apart = low.k.high < high.k.low
        text.append(
            f"The k of single logs is between {1e3 * low.k.value:.0f} ms ({low.log.frequency:g} "
            f"Hz) and {1e3 * high.k.value:.0f} ms ({high.log.frequency:g} Hz). The two intervals "
            + ("do not overlap, so no single lag fits all frequencies." if apart else "overlap.")
        )
    held = [x.log.path.name for x in found.logs if x.rms_held < min(rms(x.after), rms(x.before))]
    if held:
        text.append(
            f"In {', '.join(held)}, the lag predicts the pressure worse than a constant pressure "
            "that is equal to the first sample."
        )
    return text


def _residual(found: Identification) -> list[str]:
    shapes = [x.shape for x in found.logs]
    square = np.array([s.rms**2 for s in shapes])

    def share(values) -> float:
        return float(np.sum(square * np.asarray(values)) / np.sum(square))

    mean, offset = share([s.mean_share for s in shapes]), np.mean([s.mean for s in shapes])
    first, second, third = (share([s.harmonic_shares[i] for s in shapes]) for i in range(3))
    irregular = share([s.not_repeating_rms**2 / s.rms**2 for s in shapes])
    text = [
        "Parts of the residual's mean square, with a separate k for each log: constant offset "
        f"{mean:.0%} (on average, the measured pressure is {abs(offset):.1f} psi "
        f"{'above' if offset > 0 else 'below'} the model), drive frequency {first:.0%}, twice the "
        f"drive frequency {second:.0%}, three times the drive frequency {third:.0%}, not periodic "
        f"{irregular:.1%}.",
        "At the drive frequency, the amplitude of the logs' residuals is "
        f"{_signed([s.in_phase for s in shapes])} psi in phase with the command, and "
        f"{_signed([s.quadrature for s in shapes])} psi a quarter cycle behind the command.",
        "The mean of the logs' residuals is "
        f"{_signed([s.mean_filling for s in shapes])} psi while the fill valve is open, and "
        f"{_signed([s.mean_venting for s in shapes])} psi while the vent valve is open.",
    ]
    up, down = ([getattr(s, name) for s in shapes] for name in ("k_filling", "k_venting"))
    ratio = [d / u for u, d in zip(up, down, strict=True) if math.isfinite(u) and math.isfinite(d)]
    if ratio:
        same = min(ratio) <= 1.0 <= max(ratio)
        text.append(
            f"Pressure error divided by rate: {_range_ms(up)} ms while filling, {_range_ms(down)} "
            f"ms while venting. Venting takes {min(ratio):.2g} to {max(ratio):.2g} times as long"
            + ("." if same else f", {'longer' if min(ratio) > 1.0 else 'shorter'} in every log.")
        )
    gains, phases = ([getattr(s.measured, n) for s in shapes] for n in ("k_of_gain", "k_of_phase"))
    both = [(g, p) for g, p in zip(gains, phases, strict=True) if math.isfinite(g + p)]
    beyond = [x.log.path.name for x in found.logs if x.shape.measured.lag >= 0.5 * math.pi]
    if both:
        text.append(
            f"At the drive frequency, the measured gain gives k = {_range_ms(gains)} ms, and the "
            f"phase gives k = {_range_ms(phases)} ms. For a lag, both values are equal; these "
            f"values differ by a factor of up to {max(max(g / p, p / g) for g, p in both):.1f}."
        )
    if beyond:
        text.append(
            f"In {', '.join(beyond)}, the pressure is over a quarter cycle late: this is not a lag."
        )
    return text


def _signed(values) -> str:
    return _range(values, "+.1f", "unknown")


def _range_ms(values) -> str:
    return _range([1e3 * v for v in values], ".0f", "no value")


def _range(values, form: str, none: str) -> str:
    finite = [v for v in values if math.isfinite(v)]
    ends = [min(finite), max(finite)][: len(finite)] if finite else []
    return " to ".join(f"{x:{form}}" for x in ends) or none
