"""What to measure next, once the loop has said what it found.

A class asks for the trial that tells its members apart; a residual that nobody explains, or trials
that do not agree, for the worst condition once more; all else for the trial that narrows the widest
interval.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from calibration.closing import Outcome
from calibration.evidence import summed
from calibration.fit import inverse
from calibration.foresight import Foresight, Sensing, information
from calibration.forward import DIRECTIONS
from calibration.next_trial import (
    Effort,
    Limits,
    Search,
    as_table,
    free_name,
    limits_of,
    toml,
    words,
)
from calibration.search import Round, groups
from calibration.separation import separate
from calibration.systematic import EFFECT, SYSTEMATIC
from calibration.verdict import CLASS, INCONCLUSIVE, UNEXPLAINED
from slider_jax.errors import InputError, SolverError
from slider_jax.fingerprint import typical

LOOP = Effort(spread=12, rounds=1)
"""Trials that are tried at the end of the loop, which has minutes in all."""
Say = Callable[[str], None]


def next_experiment(
    outcome: Outcome,
    progress: Say = lambda text: None,
    limits: Limits | None = None,
    effort: Effort = LOOP,
) -> dict[str, Any]:
    """What to measure next, as report.json says it: purpose, a sentence, and a trial or None.

    `limits` are those of the experiment's own trials by default.
    """
    alike = any(r.alike for r in outcome.search.rounds if r.chosen)
    if outcome.verdict in (UNEXPLAINED, INCONCLUSIVE) or (outcome.verdict == CLASS and not alike):
        return _again(outcome)
    try:
        within = limits_of(outcome.experiment) if limits is None else limits
        if outcome.verdict == CLASS:
            return _separated(outcome, within, effort, progress)
        return _narrowed(outcome, within, effort, progress)
    except (InputError, SolverError) as error:
        return _none(f"No trial is proposed: {error}")


def _none(said: str) -> dict[str, Any]:
    return {"purpose": None, "said": said, "trial": None, "toml": ""}


def _again(outcome: Outcome) -> dict[str, Any]:
    """The trial whose residual stands highest above its noise, once more."""
    seen = [r for i, r in enumerate(outcome.problem.records) if i not in outcome.held]
    channel, x = max(outcome.excess_after.items(), key=lambda item: np.nanmax(item[1].trials))
    worst = int(np.nanargmax(x.trials))
    trial = seen[worst].trial
    again = trial.model_copy(update={"file": free_name(outcome.experiment)})
    said = (
        f"Repeat {trial.file} ({words(trial)}), where {channel} is furthest from the model: its "
        f"mean square is {x.trials[worst]:.1f} times the noise's. A cause in the tank leaves the "
        "same residual again; one of that day's setting does not."
    )
    return {"purpose": "repeat", "said": said, "trial": as_table(again), "toml": toml(again)}


def _foresight(outcome: Outcome, chosen: np.ndarray, secants: dict[int, float]) -> Foresight:
    names = tuple(groups(outcome.entries))
    experiment, theta = outcome.experiment, outcome.final.theta
    sensing = Sensing.of(experiment, outcome.problem.records)
    coarse = outcome.problem.mesh
    memo = outcome.problem.memo
    return Foresight(experiment, names, theta, chosen, sensing, secants, coarse, memo)


def _separated(outcome: Outcome, limits: Limits, effort: Effort, progress: Say) -> dict[str, Any]:
    this = next(r for r in outcome.search.rounds if r.chosen and r.alike)
    assert this.chosen is not None
    members, free = groups(outcome.entries), outcome.final.free
    room = DIRECTIONS - len(free)
    names, used = [this.chosen], 0
    for rival in this.alike:
        used += len(members[rival])
        if used <= max(room, len(members[this.alike[0]])):
            names.append(rival)
    full = {name: _size(outcome, this, name) for name in names}
    rivals = np.concatenate([members[n] for n in names[1:]])
    steps = np.concatenate([full[n] for n in names[1:]])
    # A rival may have been added in a later round: it is in the fit then, at its size.
    new = ~np.isin(rivals, free)
    chosen = np.concatenate([free, rivals[new]])
    # At the sizes that were fitted, as the tangent at the null can say little of them.
    secants = {int(i): float(x) for i, x in zip(rivals[new], steps[new], strict=True) if x != 0.0}
    f = _foresight(outcome, chosen, secants)
    progress(f"what the next trial could say of {', '.join(names)}")
    before = information(f.trials([r.trial for r in outcome.problem.records]))
    own = {n: np.flatnonzero(np.isin(chosen, members[n])) for n in names}
    return separate(f, before, own, full, limits, effort, progress)


def _size(outcome: Outcome, this: Round, name: str) -> np.ndarray:
    """How far the parameters of an effect are from their null as far as the round knows."""
    group = groups(outcome.entries)[name]
    null = np.array([outcome.entries[i].prior.null for i in group])
    if name == this.chosen or name in outcome.search.effects:
        return outcome.final.theta[group] - null
    tried = next((t for t in this.tried if t.name == name), None)
    if tried is not None:
        return tried.fit.theta[group] - null
    estimate = next(s.estimate for s in this.scores if s.name == name)
    ends = np.array([typical(outcome.entries[i].prior) for i in group]) - null
    return np.clip(estimate, -np.abs(ends), np.abs(ends))


def _narrowed(outcome: Outcome, limits: Limits, effort: Effort, progress: Say) -> dict[str, Any]:
    final, entries = outcome.final, outcome.entries
    errors = final.errors
    own = [entries[i] for i in final.free]
    floor = np.array(
        [
            (EFFECT if p.effect else SYSTEMATIC[p.name]) * abs(final.theta[i])
            for i, p in zip(final.free, own, strict=True)
        ]
    )
    widest = int(np.argmax(errors / np.maximum(floor, 1e-300)))
    if errors[widest] <= floor[widest]:
        return _none(
            "No trial is proposed: what two correct programs differ by is the larger part of every "
            "interval, so more of such data would not narrow one."
        )
    f = _foresight(outcome, final.free, {})
    p, before = own[widest], summed(final.blocks)[0]

    def goal(A: np.ndarray) -> float:
        return -float(inverse(A)[widest, widest])

    progress(f"what the next trial could say of {p.label}")
    best = Search(f, before, goal, limits).run(effort, progress)
    after = float(np.sqrt(final.inflation * -best.value))
    unit = "" if p.prior.unit == "-" else f" {p.prior.unit}"
    said = (
        f"{words(best.trial)} narrows the widest interval most, that of {p.label}: its standard "
        f"error by noise from {errors[widest]:.2g} to {after:.2g}{unit}."
    )
    return {
        "purpose": "narrow",
        "said": said[0].upper() + said[1:],
        "trial": as_table(best.trial),
        "toml": toml(best.trial),
        "parameter": p.label,
        "error_before": errors[widest],
        "error_after": after,
        "limits": limits._asdict(),
    }
