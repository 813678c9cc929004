"""Judges the paper's statements by the built-in robot and by the joint assumptions."""

import json
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slider_jax import paper
from slider_jax.optimise.design_space import VARIABLES
from slider_jax.reproduction.design_findings import StatementCheck
from slider_jax.statements.assumptions import RANGES, Assumptions, to_unit
from slider_jax.statements.statements import (
    ASSUMED,
    CONSISTENT,
    FAILED,
    GIVEN,
    INCONSISTENT,
    MISSED,
    OMITTED,
    PRINTED,
    REPRODUCED,
    SIMULATED,
    VERDICTS,
)
from slider_jax.swimming.gait import Gait
from slider_jax.swimming.paper_optimum import PAPER_GAIT

JOINT_FIT = Path(__file__).with_name("joint_fit.json")
"""The result of `scripts/fit_assumptions.py`."""
OF_OPTIMUM = {
    "frequency": "frequency",
    "front": "front pressure",
    "rear": "rear pressure",
    "phase": "phase",
    "tail_length": "length of the tail",
    "EI_tail": "stiffness of the tail",
}
"""Texts for the variables of the optimum."""


CHECKED = ("simulated", "map", "optimum", "multimodal")
"""Kinds of statements that a simulation can check."""


class Judgement(NamedTuple):
    """The verdict on a statement. Values are in `unit`; None if there is no value."""

    name: str
    kind: str
    """`simulated`, `map`, `optimum`, `multimodal`, `printed` or `given`."""
    place: str
    text: str
    allowed: str
    """The allowed interval, the rule of the check, or the printed number with its tolerance."""
    unit: str
    built_in: float | None
    """Value of the built-in robot, or of the calculation with the paper's own numbers."""
    fitted: float | None
    """Value with the joint assumptions."""
    verdict: str
    why: str
    """The assumptions that matter, the calculation, or the reason."""
    joint_agrees: bool = False
    """Whether the statement agrees with the joint assumptions."""


class Evidence(NamedTuple):
    """The facts from which the verdicts on `SIMULATED` follow, all with the same settings."""

    built_in: dict[str, float]
    fitted: dict[str, float]
    reverted: dict[str, dict[str, float]]
    """Facts of the joint assumptions if one of them returns to the built-in value."""
    changed: list[tuple[str, float, dict[str, float]]]
    """Facts of the built-in robot if one assumption has another value: name, value and facts."""
    witnesses: dict[str, tuple[Assumptions, dict[str, float]]]
    """For each statement, the set from `joint_fit.witness`, and its facts."""


@cache
def joint_fit() -> dict[str, Any]:
    """Returns the stored result of the searches."""
    return json.loads(JOINT_FIT.read_text(encoding="utf-8"))


def fitted_assumptions(found: dict[str, Any]) -> Assumptions:
    """Returns the joint assumptions, the result of the gradient steps."""
    return Assumptions(**found["refined"]["assumptions"])


def judged(x: Evidence) -> list[Judgement]:
    """Returns the verdicts on the statements that need no maps and no optimisation."""
    found = [_simulated(name, x) for name in SIMULATED]
    for name, one in PRINTED.items():
        verdict = CONSISTENT if one.agrees else INCONSISTENT
        stated = f"{one.stated:g} ± {one.digit:g}"
        found.append(Judgement(name, "printed", one.place, one.text, stated, one.unit, one.computed,
                               None, verdict, one.calculation))  # fmt: skip
    for name, given in GIVEN.items():
        found.append(Judgement(name, "given", given.place, given.text, "", "", None, None,
                               given.verdict, given.reason))  # fmt: skip
    return found


def judged_maps(built_in: list[StatementCheck], fitted: list[StatementCheck]) -> list[Judgement]:
    """Returns the verdicts on the statements about the whole maps of Fig. 7."""
    found = []
    for here, joint in zip(built_in, fitted, strict=True):
        verdict = REPRODUCED if here.agrees else ASSUMED if joint.agrees else MISSED
        why = f"built-in robot: {here.measured}; joint assumptions: {joint.measured}"
        found.append(Judgement(here.claim, "map", "Fig. 7a, b", here.claim, here.rule, "", None,
                               None, verdict, why, bool(joint.agrees)))  # fmt: skip
    return found


def judged_optimum(optima: list[tuple[Gait, float]], stated: float) -> list[Judgement]:
    """Returns the verdicts on the optimum of the genetic algorithm.

    `optima` are gait and speed [m/s] of the built-in robot and of the joint assumptions.
    """
    rows = [(name, f"optimal {OF_OPTIMUM[name]}", getattr(PAPER_GAIT, name), VARIABLES[name].factor,
             VARIABLES[name].unit, [getattr(gait, name) for gait, _ in optima])
            for name in Gait._fields]  # fmt: skip
    rows.append(("speed", "speed of the optimum", stated, 100.0, "cm/s", [u for _, u in optima]))
    found = []
    for name, text, value, factor, unit, (here, joint) in rows:
        agree = [abs(x / value - 1.0) <= paper.NEAR for x in (here, joint)]
        verdict = REPRODUCED if agree[0] else ASSUMED if agree[1] else MISSED
        limits = interval_text(*sorted(factor * value * (1.0 + s * paper.NEAR) for s in (-1, 1)))
        found.append(
            Judgement(f"optimum_{name}", "optimum", "Optimum of the genetic algorithm",
                      f"The {text} is {factor * value:.4g} {unit}.", limits, unit, factor * here,
                      factor * joint, verdict, "result of the genetic algorithm", agree[1])
        )  # fmt: skip
    return found


def _simulated(name: str, x: Evidence) -> Judgement:
    one = SIMULATED[name]
    here, fitted = x.built_in[one.fact], x.fitted[one.fact]
    witness, facts = x.witnesses[name]
    changes = _single_changes(name, x)
    why = [one.reading] if one.reading else []
    if one.agrees(here):
        verdict = REPRODUCED
    elif one.agrees(fitted):
        verdict = ASSUMED
        lost = [k for k, other in x.reverted.items()
                if np.isfinite(other[one.fact]) and not one.agrees(other[one.fact])]  # fmt: skip
        if lost:
            why.append("joint assumptions; not if one of these returns: " + ", ".join(lost))
    elif changes or one.agrees(facts[one.fact]):
        verdict = ASSUMED
        if not changes:
            largest = np.abs(to_unit(witness) - to_unit(Assumptions()))
            names = [list(RANGES)[i] for i in np.argsort(-largest)[:4]]
            text = ", ".join(f"{k} = {float(getattr(witness, k)):.3g}" for k in names)
            why.append(f"not with the joint assumptions, but with another set, such as {text}")
    elif np.isfinite([here, fitted, facts[one.fact]]).any():
        verdict = MISSED
    else:
        verdict = FAILED
    if changes and verdict == ASSUMED:
        why.append(f"one change of the built-in robot is enough: {', '.join(changes)}")
    return Judgement(
        name, "simulated", one.place, one.text,
        interval_text(one.low * one.factor, one.high * one.factor), one.unit, one.factor * here,
        one.factor * fitted, verdict, "; ".join(why), one.agrees(fitted),
    )  # fmt: skip


def _single_changes(name: str, x: Evidence) -> list[str]:
    """Returns, for each assumption that is enough alone, the value nearest to the built-in one."""
    one, start = SIMULATED[name], dict(zip(RANGES, to_unit(Assumptions()), strict=True))
    found: dict[str, tuple[float, float]] = {}
    for assumption, value, facts in x.changed:
        if one.agrees(facts[one.fact]):
            changed = dict(zip(RANGES, to_unit(Assumptions(**{assumption: value})), strict=True))
            far = abs(changed[assumption] - start[assumption])
            if assumption not in found or far < found[assumption][0]:
                found[assumption] = far, value
    return [f"{k} = {value:.3g} {RANGES[k].unit}" for k, (_, value) in found.items()]


def interval_text(low: float, high: float) -> str:
    """Returns the allowed interval as text; an end may be infinite."""
    if not np.isfinite(low):
        return f"at most {high:.4g}"
    if not np.isfinite(high):
        return f"at least {low:.4g}"
    return f"{low:.4g} to {high:.4g}"


def counts(found: list[Judgement]) -> dict[str, int]:
    """Returns the number of statements with each verdict that occurs."""
    numbers = {verdict: sum(x.verdict == verdict for x in found) for verdict in VERDICTS}
    return {verdict: number for verdict, number in numbers.items() if number}


def summary_sentence(found: list[Judgement]) -> str:
    """Returns how many simulated statements agree, in three sentences."""
    simulated = [x for x in found if x.kind in CHECKED and x.verdict != OMITTED]
    number = {v: sum(x.verdict == v for x in simulated) for v in (REPRODUCED, ASSUMED)}
    joint = sum(x.joint_agrees for x in simulated)
    return (
        f"Of {len(simulated)} statements that a simulation can check, the built-in robot "
        f"reproduces {number[REPRODUCED]}. With the joint assumptions, {joint} agree at once. "
        f"{number[REPRODUCED] + number[ASSUMED]} agree with some set of assumptions."
    )
