"""Checks the paper's statements about design maps (Fig. 7) with computed maps of the speed."""

from typing import NamedTuple

import numpy as np

from slider_jax.reproduction.design_maps import (
    BEST_PHASE,
    MARKED,
    MARKED_LENGTH,
    TOLERANCE,
    Map,
    best_phase,
    best_stiffness,
)

POOR = 0.5
"""A speed counts as poor if it is less than this fraction of the better speed (assumed)."""


class StatementCheck(NamedTuple):
    """Result of checking one of the paper's statements."""

    claim: str
    rule: str
    """Criterion of the check. `measured` is the result from the computed maps, as text."""
    measured: str
    agrees: bool | None
    """Whether the maps agree with the claim; None if a needed point has no steady speed."""

    @property
    def verdict(self) -> str:
        """`agrees` as text."""
        return {True: "agrees", False: "does not agree", None: "not decided"}[self.agrees]


def interior_optimum(over_stiffness: Map) -> StatementCheck:
    """Checks whether, at every length, the best stiffness is inside the computed range."""
    lengths, peaks = over_stiffness.lengths, best_stiffness(over_stiffness)
    inside = np.array([np.nan if p.inside is None else p.inside for p in peaks])
    best = np.where(np.isnan(inside), np.nan, [1e3 * p.x for p in peaks])
    low, high = 1e3 * over_stiffness.across[[0, -1]]
    ends = lengths[inside == 0.0]
    return StatementCheck(
        "there is a best stiffness for every tail length",
        f"at every length the fastest stiffness is inside the range {low:g} to {high:g} mN m^2",
        f"best {_text(lengths, best, '.2g')} (mN m^2)"
        + (f"; at an end of the range for {_mm(ends)}" if ends.size else ""),
        _everywhere(inside == 1.0, inside),
    )


def short_tails_phase(over_phase: Map) -> StatementCheck:
    """Checks whether the best phase of the shorter tails is near the paper's best phase."""
    short = _short(over_phase)
    lengths, best = over_phase.lengths[short], _tops(over_phase)[0][short]
    off = best - BEST_PHASE
    far = lengths[np.abs(off) > TOLERANCE]
    return StatementCheck(
        f"the best phase is near {BEST_PHASE:g} for short tails",
        f"the difference is at most {TOLERANCE:g} for every tail up to {_mm(MARKED_LENGTH)}",
        f"best {_text(lengths, best, '.3f')}; difference {_text(lengths, off, '+.3f')}"
        + (f"; too large for {_mm(far)}" if far.size else ""),
        _everywhere(np.abs(off) <= TOLERANCE, best),
    )


def negative_is_slower(over_phase: Map) -> StatementCheck:
    """Checks whether swimmers with negative phase are slower than swimmers with phase 0."""
    phases = over_phase.across
    negative = over_phase.speed[:, (phases < 0.0) & (phases > -0.5)]
    lead = over_phase.at(0.0) - np.max(negative, axis=1)
    return StatementCheck(
        "negative phase is slower",
        "at every length every negative phase is slower than phase 0; phase -0.5 is excluded, "
        "because it equals phase 0.5",
        "the fastest negative phase is slower by "
        + f"{_text(over_phase.lengths, 1e2 * lead, '.1f')} (cm/s)",
        _everywhere(lead > 0.0, lead),
    )


def half_is_poor(over_phase: Map) -> StatementCheck:
    """Checks whether phase 0.5 is much slower than the paper's good phase of 0.2."""
    _, good, poor = (over_phase.at(phase) for phase in MARKED)
    both = np.isfinite(poor + good)
    slow, fast = (
        _text(over_phase.lengths, 1e2 * np.where(both, x, np.nan), ".1f") for x in (poor, good)
    )
    return StatementCheck(
        f"phase {MARKED[2]:g} is poor compared with {MARKED[1]:g}",
        f"at every length the speed is less than {POOR:g} times the speed at {MARKED[1]:g}",
        f"{slow}, compared with {fast} (cm/s)",
        _everywhere(poor < POOR * good, poor + good),
    )


def long_tails_gain_less(over_phase: Map) -> StatementCheck:
    """Checks whether the best phase increases the speed of long tails less than of short tails."""
    gain, short = _tops(over_phase)[1] - over_phase.at(0.0), _short(over_phase)
    found = np.isfinite(gain)
    parts = (gain[found & part] for part in (~short, short))
    long_mean, short_mean = (1e2 * float(np.mean(x)) if x.size else np.nan for x in parts)
    return StatementCheck(
        "longer tails gain less speed from the best phase",
        "the mean gain in speed from phase 0 to the best phase is smaller for tails longer than "
        f"{_mm(MARKED_LENGTH)} than for shorter tails",
        f"{long_mean:.1f} compared with {short_mean:.1f}; "
        f"{_text(over_phase.lengths, 1e2 * gain, '.1f')} (cm/s)",
        _everywhere(long_mean < short_mean, long_mean - short_mean),
    )


def slice_of_phase(over_phase: Map) -> list[StatementCheck]:
    """Checks statements about a 60 mm tail: its best phase, and negative phases."""
    one = over_phase.slice_at(MARKED_LENGTH)
    (top,), (speed,) = _tops(one)
    of_slice = f"tail of {_mm(one.lengths)}: "
    return [
        StatementCheck(
            f"{of_slice}the best phase is {BEST_PHASE:g}",
            f"the best phase differs by at most {TOLERANCE:g}",
            f"{top:.3f}, difference {top - BEST_PHASE:+.3f}; {1e2 * speed:.1f} cm/s at that phase",
            _everywhere(np.abs(top - BEST_PHASE) <= TOLERANCE, top),
        ),
        negative_is_slower(one)._replace(claim=f"{of_slice}negative phase is slower"),
    ]


def findings(over_stiffness: Map, over_phase: Map) -> list[StatementCheck]:
    """Returns the results of all checks."""
    return [
        interior_optimum(over_stiffness),
        short_tails_phase(over_phase),
        negative_is_slower(over_phase),
        half_is_poor(over_phase),
        long_tails_gain_less(over_phase),
        *slice_of_phase(over_phase),
    ]


def _tops(over_phase: Map) -> tuple[np.ndarray, np.ndarray]:
    """Returns best phases and speeds (n,); NaN if a neighbour of the best point has no speed."""
    peaks = best_phase(over_phase)
    known = [p.inside is not None for p in peaks]
    best, speed = (np.array([getattr(p, name) for p in peaks]) for name in "xy")
    return np.where(known, best, np.nan), np.where(known, speed, np.nan)


def _short(over_phase: Map) -> np.ndarray:
    return over_phase.lengths < MARKED_LENGTH + 1e-9


def _everywhere(condition, needed) -> bool | None:
    """Returns whether a condition holds wherever `needed` is finite; None if all are NaN."""
    found = np.isfinite(needed)
    return bool(np.all(np.asarray(condition)[found])) if found.any() else None


def _mm(lengths) -> str:
    return ", ".join(f"{1e3 * x:.3g}" for x in np.atleast_1d(lengths)) + " mm"


def _text(lengths: np.ndarray, values, form: str) -> str:
    """Returns the values of the shortest and longest tail, the range, and the missing lengths."""
    values, found = np.asarray(values, float), np.isfinite(values)
    lost = f"; missing for {_mm(lengths[~found])}" if not found.all() else ""
    if not found.any():
        return lost.removeprefix("; ")
    at, x = lengths[found], values[found]
    first, last, low, high = (format(v, form) for v in (x[0], x[-1], np.min(x), np.max(x)))
    if len(x) == 1:
        return first + lost
    return f"{first} at {_mm(at[0])} to {last} at {_mm(at[-1])}, {low} to {high} overall{lost}"
