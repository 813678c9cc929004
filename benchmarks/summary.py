"""The benchmark of the loop as tables."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from strangers import STRANGERS

from calibration.discrepancy.verdict import CLASS, IDENTIFIED, NAMED, NOTHING, UNEXPLAINED
from slider_jax.effects.library import LIBRARY

WAYS = ("refit only", "sparse", "stepwise", "gp", "loop", "oracle")
ABOVE = 1.1
"""Held-out rms over its floor from which on there is something to explain."""


def read(out: Path, kind: str) -> list[dict[str, Any]]:
    """The finished cases of a kind."""
    found = [json.loads(p.read_text()) for p in sorted((out / kind).glob("*.json"))]
    return [x for x in found if "left_out" not in x]


def said(case: dict[str, Any], way: str = "loop") -> list[set[str]]:
    """What was named: a set of names for every cause."""
    if way == "loop":
        if case["verdict"] not in NAMED:
            return []
        return [{e["name"], *e["class"]} for e in case["effects"]]
    return [{name} for name in case["named_by"].get(way, [])]


def hits(causes: Sequence[set[str]], truth: Iterable[str]) -> int:
    """How many of the true effects are among the causes, each cause counting once."""
    match = np.array([[name in cause for name in truth] for cause in causes], float)
    if not match.size:
        return 0
    rows, columns = linear_sum_assignment(match, maximize=True)
    return int(match[rows, columns].sum())


def right(case: dict[str, Any], way: str = "loop", most: int = 99) -> bool:
    """Whether the true effect and nothing else was named, in a class of at most so many."""
    causes = said(case, way)
    named = len(causes) == 1 and hits(causes, case["case"]["effects"]) == 1
    return named and len(causes[0]) <= most


def f1(found: Sequence[dict[str, Any]], way: str = "loop") -> float:
    """Of the sets of causes, all cases together."""
    matched = sum(hits(said(x, way), x["case"]["effects"]) for x in found)
    named = sum(len(said(x, way)) for x in found)
    true = sum(len(x["case"]["effects"]) for x in found)
    return 2.0 * matched / (named + true) if named + true else float("nan")


def skills(found: Iterable[dict[str, Any]], way: str = "loop") -> list[float]:
    """(before - after)/(before - floor) on the trials held out, where before stands above it."""
    errors = [x["held_out_over_floor"] for x in found]
    return [
        (e["refit only"] - e[way]) / (e["refit only"] - 1.0)
        for e in errors
        if e["refit only"] > ABOVE and way in e
    ]


def place_of_stranger(case: dict[str, Any]) -> str:
    """What the loop said of an effect that is not in the library, in a word."""
    truth = STRANGERS[case["case"]["stranger"]]
    if case["verdict"] == IDENTIFIED:
        return "wrong name"
    if case["verdict"] == CLASS:
        places = {LIBRARY[n].place() for cause in said(case) for n in cause}
        return "right place" if places & set(truth.places) else "wrong place"
    if case["verdict"] != UNEXPLAINED:
        return case["verdict"]
    if not case["where"]:  # an effect at the edge of what is believed stands in for the cause
        near = {e["where"] for e in case["nearest"]}
        return "right place" if near & set(truth.places) else "wrong place"
    worst = max(case["where"], key=lambda x: x["mean_square_over_noise"])
    return "right place" if worst["channel"] in truth.channels else "wrong place"


def _share(flags: Sequence[bool]) -> str:
    return f"{sum(flags)} of {len(flags)} ({np.mean(flags):.0%})" if flags else "none"


def summed_up(out: Path) -> str:
    """All tables, as Markdown."""
    parts = []
    if tanks := read(out, "null"):
        parts.append(_nothing(tanks))
    if fits := read(out, "coverage"):
        parts.append(_covered(fits))
    singles = read(out, "single")
    if singles:
        lines = [
            "| times the limit | right | right, alone | size of a class, mean | skill, median "
            "| least | of |",
            "|---|---|---|---|---|---|---|",
        ]
        for size in sorted({x["case"]["size"] for x in singles}):
            of = [x for x in singles if x["case"]["size"] == size]
            spoke = [x for x in of if x["verdict"] in NAMED]
            sizes = [len(c) for x in spoke for c in said(x)]
            skill = skills(spoke) or [np.nan]
            lines.append(
                f"| {size:g} | {_share([right(x) for x in of])} "
                f"| {_share([right(x, most=1) for x in of])} | {np.mean(sizes or [0]):.2f} "
                f"| {np.median(skill):.3f} | {min(skill):.3f} | {len(skills(spoke))} |"
            )
        parts.append("\n".join(lines))
        wrong = [x for x in singles if not right(x)]
        parts.append("\n".join(["Not right:", *(_told(x) for x in wrong)]))
        inside = [
            v["low"] < v["truth"] < v["high"] for x in singles if right(x)
            for v in x.get("effects_cover", {}).values()
        ]  # fmt: skip
        parts.append(f"Interval of the effect's parameter holds the truth: {_share(inside)}")
    doubles = read(out, "double")
    if doubles:
        parts.append(f"Two effects, {len(doubles)} pairs: F1 {f1(doubles):.3f}")
        parts.append("\n".join(_told(x) for x in doubles))
    strangers = read(out, "outside")
    if strangers:
        words = [place_of_stranger(x) for x in strangers]
        lines = [f"Outside the library, {len(words)} kinds:"]
        lines += [f"- {w}: {words.count(w)}" for w in sorted(set(words))]
        lines += [f"{w}: {_told(x)}" for w, x in zip(words, strangers, strict=True)]
        parts.append("\n".join(lines))
    everything = [*singles, *doubles, *strangers]
    spoke = skills(x for x in everything if x["verdict"] in NAMED)
    if spoke:
        parts.append(
            f"Held-out skill of all {len(spoke)} that it speaks on: median {np.median(spoke):.3f}, "
            f"least {min(spoke):.3f}"
        )
    parts.append(_rivals([*singles, *doubles]))
    return "\n\n".join(parts)


def _nothing(tanks: Sequence[dict[str, Any]]) -> str:
    """False alarms and coverage. Noise alone is held against the fit of the tank without noise."""
    nulls = [r for x in tanks for r in x["replicates"]]
    lines = [
        f"Nothing missing, {len(nulls)} replicates of {len(tanks)} tanks: "
        f"{sum(r['verdict'] != NOTHING for r in nulls)} did not end so, "
        f"{sum(r['verdict'] in NAMED for r in nulls)} named an effect.",
        "",
        "| | interval holds the truth | noise's own holds the fit without noise |",
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
    asked = [r["named_by"] for r in nulls if "named_by" in r]
    for way in asked[0] if asked else ():
        named = _share([bool(x[way]) for x in asked])
        lines += ["", f"The rival {way} names an effect in {named}."]
    return "\n".join(lines)


def _covered(fits: Sequence[dict[str, Any]]) -> str:
    """How many intervals hold the truth, every fit being to another tank."""
    lines, all_of = [f"{len(fits)} tanks, calibrated; intervals that hold the truth:", ""], []
    for p in fits[0]["parameters"]:
        inside = [v["low"] < v["truth"] < v["high"] for v in (x["parameters"][p] for x in fits)]
        lines.append(f"- {p}: {_share(inside)}")
        all_of += inside
    return "\n".join([*lines, f"- all: {_share(all_of)}"])


def _told(x: dict[str, Any]) -> str:
    case, effects = x["case"], [(e["name"], e["class"]) for e in x["effects"]]
    truth = dict(case["effects"]) or case["stranger"]
    return (
        f"- {case['name']} (tank {case['seed']}): {x['verdict']} {effects}, truth {truth}, "
        f"held out {x['held_out_over_floor']}, {x['seconds']:.0f} s"
    )


def _rivals(found: Sequence[dict[str, Any]]) -> str:
    """All ways on the cases in which all of them spoke."""
    found = [x for x in found if x["named_by"]]
    if not found:
        return ""
    singles = [x for x in found if x["case"]["kind"] == "single"]
    doubles = [x for x in found if x["case"]["kind"] == "double"]
    lines = [
        f"{len(singles)} single effects and {len(doubles)} pairs:",
        "",
        "| | the one effect named | two effects, F1 | held-out rms over floor, median | largest | "
        "skill, median | least |",
        "|---|---|---|---|---|---|---|",
    ]
    for way in WAYS:
        errors = [x["held_out_over_floor"][way] for x in found]
        skill = skills(found, way) or [np.nan]
        naming = way in ("sparse", "stepwise", "loop")
        one = f"{np.mean([right(x, way) for x in singles]):.0%}" if naming and singles else ""
        two = f"{f1(doubles, way):.2f}" if naming and doubles else ""
        lines.append(
            f"| {way} | {one} | {two} | {np.median(errors):.2f} | {max(errors):.2f} "
            f"| {np.median(skill):.2f} | {min(skill):.2f} |"
        )
    return "\n".join(lines)
