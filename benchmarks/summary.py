"""Summarises the benchmark of the loop in tables."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from unknown_effects import UNKNOWN_EFFECTS

from calibration.discrepancy.verdict import BEYOND_PRIOR, INCONCLUSIVE, NOTHING, PARTLY, UNEXPLAINED
from slider_jax.effects.library import LIBRARY

METHODS = ("refit only", "sparse", "stepwise", "gp", "loop", "oracle")
EXPLAINABLE = 1.1
"""A case has a residual to explain if the held-out rms divided by the noise floor is larger."""


def read_cases(out: Path, kind: str) -> list[dict[str, Any]]:
    """Returns the completed cases of a kind."""
    found = [json.loads(p.read_text()) for p in sorted((out / kind).glob("*.json"))]
    return [x for x in found if "left_out" not in x]


def named_causes(case: dict[str, Any], method: str = "loop") -> list[set[str]]:
    """Returns the named causes, each as a set of equivalent effects.

    The loop names no cause in channels with a residual above the noise floor.
    """
    if method == "loop":
        return [{e["name"], *e["class"]} for e in case["effects"] if _is_named(case, e)]
    return [{name} for name in case["named_by"].get(method, [])]


def _is_named(case: dict[str, Any], effect: dict[str, Any]) -> bool:
    return case["verdict"] != INCONCLUSIVE and not effect["above_floor"]


def matched_effects(causes: Sequence[set[str]], truth: Iterable[str]) -> int:
    """Returns the number of true effects among the causes. Each cause counts once."""
    match = np.array([[name in cause for name in truth] for cause in causes], float)
    if not match.size:
        return 0
    rows, columns = linear_sum_assignment(match, maximize=True)
    return int(match[rows, columns].sum())


def is_right(case: dict[str, Any], method: str = "loop", most: int = 99) -> bool:
    """Returns True if only the true effect was named, in a class of at most `most` effects."""
    causes = named_causes(case, method)
    named = len(causes) == 1 and matched_effects(causes, case["case"]["effects"]) == 1
    return named and len(causes[0]) <= most


def f1(found: Sequence[dict[str, Any]], method: str = "loop") -> float:
    """Returns the F1 score of the named causes over all cases."""
    matched = sum(matched_effects(named_causes(x, method), x["case"]["effects"]) for x in found)
    named = sum(len(named_causes(x, method)) for x in found)
    true = sum(len(x["case"]["effects"]) for x in found)
    return 2.0 * matched / (named + true) if named + true else float("nan")


def skills(found: Iterable[dict[str, Any]], method: str = "loop") -> list[float]:
    """Returns the skill (before - after)/(before - noise floor) of the error in held-out trials.

    Only cases with a residual count.
    """
    errors = [x["held_out_over_floor"] for x in found]
    return [
        (e["refit only"] - e[method]) / (e["refit only"] - 1.0)
        for e in errors
        if e["refit only"] > EXPLAINABLE and method in e
    ]


def location_verdict(case: dict[str, Any]) -> str:
    """Returns the rating of the loop's verdict on an effect outside the library."""
    truth = UNKNOWN_EFFECTS[case["case"]["stranger"]]
    causes = named_causes(case)
    if causes:
        doubted = all(e["class"] or e["status"] == BEYOND_PRIOR for e in case["effects"])
        if not doubted:
            return "wrong name"
        places = {LIBRARY[n].place() for cause in causes for n in cause}
        return "right place" if places & set(truth.places) else "wrong place"
    if case["verdict"] not in (PARTLY, UNEXPLAINED):
        return case["verdict"]
    worst = max(case["where"], key=lambda x: x["mean_square_over_noise"])
    return "right place" if worst["channel"] in truth.channels else "wrong place"


def _share(flags: Sequence[bool]) -> str:
    return f"{sum(flags)} of {len(flags)} ({np.mean(flags):.0%})" if flags else "none"


def summary_tables(out: Path) -> str:
    """Returns all tables as Markdown."""
    parts = []
    if tanks := read_cases(out, "null"):
        parts.append(_null_table(tanks))
    if fits := read_cases(out, "coverage"):
        parts.append(_coverage_list(fits))
    singles = read_cases(out, "single")
    if singles:
        lines = [
            "| size divided by detection limit | correct | correct, without equivalent effects "
            "| mean number of effects in a class | median skill | smallest skill | cases |",
            "|---|---|---|---|---|---|---|",
        ]
        for size in sorted({x["case"]["size"] for x in singles}):
            of = [x for x in singles if x["case"]["size"] == size]
            named = [x for x in of if named_causes(x)]
            sizes = [len(c) for x in named for c in named_causes(x)]
            skill = skills(named) or [np.nan]
            lines.append(
                f"| {size:g} | {_share([is_right(x) for x in of])} "
                f"| {_share([is_right(x, most=1) for x in of])} | {np.mean(sizes or [0]):.2f} "
                f"| {np.median(skill):.3f} | {min(skill):.3f} | {len(skills(named))} |"
            )
        parts.append("\n".join(lines))
        wrong = [x for x in singles if not is_right(x)]
        parts.append("\n".join(["Incorrect:", *(_case_line(x) for x in wrong)]))
        inside = [
            v["low"] < v["truth"] < v["high"] for x in singles if is_right(x)
            for v in x.get("effects_cover", {}).values()
        ]  # fmt: skip
        parts.append(f"The interval of the effect's parameter contains the truth: {_share(inside)}")
    doubles = read_cases(out, "double")
    if doubles:
        parts.append(f"Two effects, {len(doubles)} pairs: F1 {f1(doubles):.3f}")
        parts.append("\n".join(_case_line(x) for x in doubles))
    unknown_effects = read_cases(out, "outside")
    if unknown_effects:
        ratings = [location_verdict(x) for x in unknown_effects]
        lines = [f"{len(ratings)} effects outside the library:"]
        lines += [f"- {x}: {ratings.count(x)}" for x in sorted(set(ratings))]
        pairs = zip(ratings, unknown_effects, strict=True)
        lines += [f"{rating}: {_case_line(x)}" for rating, x in pairs]
        parts.append("\n".join(lines))
    everything = [*singles, *doubles, *unknown_effects]
    skill = skills(x for x in everything if named_causes(x))
    if skill:
        parts.append(
            f"Held-out skill in {len(skill)} cases with a named effect: median "
            f"{np.median(skill):.3f}, smallest {min(skill):.3f}"
        )
    parts.append(_method_table([*singles, *doubles]))
    return "\n\n".join(parts)


def _null_table(tanks: Sequence[dict[str, Any]]) -> str:
    """Returns the number of false alarms and the coverage of the intervals in the replicates."""
    nulls = [r for x in tanks for r in x["replicates"]]
    lines = [
        f"{len(nulls)} replicates of {len(tanks)} tanks without a missing effect: "
        f"{sum(r['verdict'] != NOTHING for r in nulls)} have a verdict other than nothing missing, "
        f"{sum(bool(named_causes(r)) for r in nulls)} name an effect.",
        "",
        "| | interval contains the truth | noise interval contains the fit without noise |",
        "|---|---|---|",
    ]
    for p in nulls[0]["parameters"]:
        inside, noise = [], []
        for x in tanks:
            for r in x["replicates"]:
                v = r["parameters"][p]
                inside.append(v["low"] < v["truth"] < v["high"])
                noise.append(abs(v["value"] - x["without_noise"][p]) < 1.96 * v["noise_error"])
        lines.append(f"| {p} | {_share(inside)} | {_share(noise)} |")
    compared = [r["named_by"] for r in nulls if "named_by" in r]
    for method in compared[0] if compared else ():
        named = _share([bool(x[method]) for x in compared])
        lines += ["", f"The method {method} names an effect in {named}."]
    return "\n".join(lines)


def _coverage_list(fits: Sequence[dict[str, Any]]) -> str:
    """Returns how many intervals contain the true value. Each fit is to a different tank."""
    lines, all_of = [f"{len(fits)} calibrated tanks; intervals that contain the truth:", ""], []
    for p in fits[0]["parameters"]:
        inside = [v["low"] < v["truth"] < v["high"] for v in (x["parameters"][p] for x in fits)]
        lines.append(f"- {p}: {_share(inside)}")
        all_of += inside
    return "\n".join([*lines, f"- all: {_share(all_of)}"])


def _case_line(x: dict[str, Any]) -> str:
    case, effects = x["case"], [(e["name"], e["class"]) for e in x["effects"]]
    truth = dict(case["effects"]) or case["stranger"]
    return (
        f"- {case['name']} (tank {case['seed']}): {x['verdict']} {effects}, truth {truth}, "
        f"held-out rms / noise floor {x['held_out_over_floor']}, {x['seconds']:.0f} s"
    )


def _method_table(found: Sequence[dict[str, Any]]) -> str:
    """Returns the table of all methods on the cases in which all methods ran."""
    found = [x for x in found if x["named_by"]]
    if not found:
        return ""
    singles = [x for x in found if x["case"]["kind"] == "single"]
    doubles = [x for x in found if x["case"]["kind"] == "double"]
    lines = [
        f"{len(singles)} single effects and {len(doubles)} pairs:",
        "",
        "| method | one effect, correct | two effects, F1 score | median held-out rms / floor "
        "| largest held-out rms / noise floor | median skill | smallest skill |",
        "|---|---|---|---|---|---|---|",
    ]
    for method in METHODS:
        errors = [x["held_out_over_floor"][method] for x in found]
        skill = skills(found, method) or [np.nan]
        naming = method in ("sparse", "stepwise", "loop")
        one = f"{np.mean([is_right(x, method) for x in singles]):.0%}" if naming and singles else ""
        two = f"{f1(doubles, method):.2f}" if naming and doubles else ""
        lines.append(
            f"| {method} | {one} | {two} | {np.median(errors):.2f} | {max(errors):.2f} "
            f"| {np.median(skill):.2f} | {min(skill):.2f} |"
        )
    return "\n".join(lines)
