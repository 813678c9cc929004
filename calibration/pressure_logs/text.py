"""The identification said in sentences made from its numbers."""

import math

import numpy as np

from calibration.pressure_logs.identify import Identification

EXPLAINED = 2.0
"""A lag that leaves at most so many times the sensor's noise explains the logs."""


def verdict(found: Identification) -> str:
    """Whether one lag explains the logs, in a sentence."""
    times = found.pooled_rmse("pooled") / found.floor
    one, these = ("One lag", "these logs") if len(found.logs) > 1 else ("A lag", "this log")
    does = "explains" if times <= EXPLAINED else "does not explain"
    return (
        f"{one} of {1e3 * found.k.value:.0f} ms {does} {these}: in a free run it leaves "
        f"{times:.2g} times the sensor's noise (up to {EXPLAINED:g} would explain them)."
    )


def describe(found: Identification) -> list[str]:
    """What was found, what is left and what shape it has, `verdict` first; no cause is named."""
    k, n = found.k, len(found.logs)
    before, after = found.pooled_rmse("before"), found.pooled_rmse("pooled")
    own, floor = found.pooled_rmse("after"), found.floor
    said = [
        verdict(found),
        f"One lag for all {n} logs: k = {1e3 * k.value:.0f} ms, 95 % interval {1e3 * k.low:.0f} to "
        f"{1e3 * k.high:.0f} ms ({'clustered by log' if n > 1 else 'correlated residual'}; "
        f"{k.widening:.0f} times the naive interval).",
        f"Free-run RMSE: {before:.2f} psi before, {after:.2f} psi with the common k, {own:.2f} psi "
        f"with each log its own; the sensor's white noise is {floor:.2f} psi.",
    ]
    if not k.fixed:
        said.append(
            f"The logs fix their common k within {1e3 * found.within.low:.0f} to "
            f"{1e3 * found.within.high:.0f} ms, but are too few, and disagree too much, to say "
            "what another log would give."
        )
    return said + _spread(found) + _residual(found)


def _spread(found: Identification) -> list[str]:
    fixed = [x for x in found.logs if x.fixed]
    loose = [x.log.path.name for x in found.logs if not x.fixed]
    said = []
    if loose:
        said.append(
            f"No k of its own is fixed by {', '.join(loose)} (interval over a factor of 10)."
        )
    if len(fixed) >= 2:
        low, high = (f(fixed, key=lambda x: x.k.value) for f in (min, max))
        apart = low.k.high < high.k.low
        said.append(
            f"k of single logs runs from {1e3 * low.k.value:.0f} ms at {low.log.frequency:g} Hz to "
            f"{1e3 * high.k.value:.0f} ms at {high.log.frequency:g} Hz; their intervals "
            + ("do not overlap, so no one lag serves all frequencies." if apart else "overlap.")
        )
    held = [x.log.path.name for x in found.logs if x.rms_held < min(_rms(x.after), _rms(x.before))]
    if held:
        said.append(
            "A pressure that stays at its first sample fits better than the lag in "
            f"{', '.join(held)}: there the free run is worse than no model."
        )
    return said


def _residual(found: Identification) -> list[str]:
    shapes = [x.shape for x in found.logs]
    square = np.array([s.rms**2 for s in shapes])

    def share(values) -> float:
        return float(np.sum(square * np.asarray(values)) / np.sum(square))

    mean, offset = share([s.mean_share for s in shapes]), np.mean([s.mean for s in shapes])
    first, second, third = (share([s.harmonic_shares[i] for s in shapes]) for i in range(3))
    loose = share([s.not_repeating_rms**2 / s.rms**2 for s in shapes])
    said = [
        f"Of the mean square left with each log its own k, {mean:.0%} is a steady offset "
        f"(measured {'above' if offset > 0 else 'below'} the model by {abs(offset):.1f} psi on "
        f"average), {first:.0%} is at the drive frequency, {second:.0%} at twice and {third:.0%} "
        f"at three times it; {loose:.1%} does not repeat from cycle to cycle.",
        "At the drive frequency the residual is "
        f"{_signed([s.in_phase for s in shapes])} psi in phase with the command and "
        f"{_signed([s.quadrature for s in shapes])} psi a quarter cycle behind it (over logs).",
        "Mean residual while the fill valve works "
        f"{_signed([s.mean_filling for s in shapes])} psi, while the vent valve works "
        f"{_signed([s.mean_venting for s in shapes])} psi (range over logs).",
    ]
    up, down = ([getattr(s, name) for s in shapes] for name in ("k_filling", "k_venting"))
    ratio = [d / u for u, d in zip(up, down, strict=True) if math.isfinite(u) and math.isfinite(d)]
    if ratio:
        same = min(ratio) <= 1.0 <= max(ratio)
        said.append(
            f"Error over rate gives {_range_ms(up)} ms while filling and {_range_ms(down)} ms "
            f"while venting: venting is {min(ratio):.2g} to {max(ratio):.2g} times as slow"
            + ("." if same else f", {'slower' if min(ratio) > 1.0 else 'faster'} in every log.")
        )
    gains, phases = ([getattr(s.measured, n) for s in shapes] for n in ("k_of_gain", "k_of_phase"))
    both = [(g, p) for g, p in zip(gains, phases, strict=True) if math.isfinite(g + p)]
    beyond = [x.log.path.name for x in found.logs if x.shape.measured.lag >= 0.5 * math.pi]
    if both:
        said.append(
            f"At the drive frequency the measured gain asks for k = {_range_ms(gains)} ms and the "
            f"measured phase for {_range_ms(phases)} ms; a first-order lag needs them equal, and "
            f"they differ by up to a factor of {max(max(g / p, p / g) for g, p in both):.1f}."
        )
    if beyond:
        said.append(f"More than a quarter cycle behind, which no lag reaches: {', '.join(beyond)}.")
    return said


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _signed(values) -> str:
    finite = [v for v in values if math.isfinite(v)]
    if not finite:
        return "unknown"
    if len(finite) == 1:
        return f"{finite[0]:+.1f}"
    return f"{min(finite):+.1f} to {max(finite):+.1f}"


def _range_ms(values) -> str:
    finite = [1e3 * v for v in values if math.isfinite(v)]
    if not finite:
        return "no value"
    if len(finite) == 1:
        return f"{finite[0]:.0f}"
    return f"{min(finite):.0f} to {max(finite):.0f}"
