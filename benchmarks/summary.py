"""Summarises the benchmark of the loop in tables."""

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from blind_effects import BLIND_EFFECTS
from common_effects import COMMON_EFFECTS
from everyday_effects import EVERYDAY_EFFECTS
from field_effects import FIELD_EFFECTS
from fresh_effects import FRESH_EFFECTS
from further_effects import FURTHER_EFFECTS
from novel_effects import NOVEL_EFFECTS
from scipy.optimize import linear_sum_assignment
from unknown_effects import UNKNOWN_EFFECTS
from unseen_effects import UNSEEN_EFFECTS
from workshop_effects import WORKSHOP_EFFECTS

from calibration.discrepancy.verdict import INCONCLUSIVE, NOTHING, PARTLY, PROVISIONAL, UNEXPLAINED
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.effects.library import LIBRARY

LACKING = {
    "outside": UNKNOWN_EFFECTS,
    "fresh": FRESH_EFFECTS,
    "blind": BLIND_EFFECTS,
    "unseen": UNSEEN_EFFECTS,
    "novel": NOVEL_EFFECTS,
    "further": FURTHER_EFFECTS,
    "common": COMMON_EFFECTS,
    "everyday": EVERYDAY_EFFECTS,
    "workshop": WORKSHOP_EFFECTS,
    "field": FIELD_EFFECTS,
}
"""Effects that the library lacks, by kind of case."""
SAME_LAW = {
    "integral_action": "regulator_integral",
    "exceeded_range": "pressure_saturation",
    "mullins_sleeve": "mullins_softening",
}
"""Effects of the list `novel` that the library has since then, and their names in the library."""
EXPLAINABLE = 1.1
"""A case has a residual to explain if the held-out rms divided by the noise floor is larger."""
NAMING = ("sparse", "stepwise", "knockoffs")
"""Other methods that name effects."""
REMOVED = 0.8
"""Fraction of the true error that a learned function should remove in the held-out trials."""


def read_cases(out: Path, kind: str) -> list[dict[str, Any]]:
    """Returns the completed cases of a kind."""
    found = [json.loads(p.read_text()) for p in sorted((out / kind).glob("*.json"))]
    return [x for x in found if "left_out" not in x]


def named_causes(case: dict[str, Any], method: str = "loop") -> list[set[str]]:
    """Returns the named causes, each as a set of equivalent effects.

    The loop names no cause in channels with a residual above the noise floor, and no effect that
    may be absent.
    """
    if method == "loop":
        return [{e["name"], *e["class"]} for e in case["effects"] if _is_named(case, e)]
    return [{name} for name in case["named_by"].get(method, [])]


def _is_named(case: dict[str, Any], effect: dict[str, Any]) -> bool:
    doubtful = (
        effect["above_floor"] or effect.get("includes_null") or effect["status"] == PROVISIONAL
    )
    replaced = case.get("learned", {}).get("replaced_effects", [])
    return case["verdict"] != INCONCLUSIVE and not doubtful and effect["name"] not in replaced


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
    errors = [x["held_out_over_floor"] for x in found if "held_out_over_floor" in x]
    return [
        (e["refit only"] - e[method]) / (e["refit only"] - 1.0)
        for e in errors
        if e["refit only"] > EXPLAINABLE and method in e
    ]


def rated_location(case: dict[str, Any]) -> str:
    """Returns the rating of the loop's verdict on an effect that the library lacks.

    A name without a doubt (a class or a residual above the noise floor) is a wrong name. Otherwise
    the place is right if a named cause, a learned function, or the channel with the largest
    residual agrees with the true effect. A function of the wrong sensor has the wrong place.
    """
    truth = LACKING[case["case"]["kind"]][next(iter(case["case"]["effects"]))]
    causes = named_causes(case)
    same = SAME_LAW.get(next(iter(case["case"]["effects"])))
    if causes and all(same in cause for cause in causes):
        return "same law in the library"
    if causes:
        if not all(len(cause) > 1 for cause in causes):
            return "wrong name"
        places = {LIBRARY[n].place() for cause in causes for n in cause}
        return "right place" if places & set(truth.places) else "wrong place"
    if case.get("learned", {}).get("terms"):
        place, _, sensor = case["learned"]["place"].rstrip(")").partition(" (")
        of_sensor = not sensor or any(
            sensor in (channel, SLIDER_CHANNELS[channel].kind) for channel in truth.channels
        )
        return "right place" if place in truth.places and of_sensor else "wrong place"
    if case["verdict"] not in (PARTLY, UNEXPLAINED):
        return case["verdict"]
    worst = max(case["where"], key=lambda x: x["mean_square_over_noise"], default=None)
    channels = [worst["channel"]] if worst else [x["channel"] for x in case["patterns"]]
    return "right place" if set(channels) & set(truth.channels) else "wrong place"


def removed_error(
    case: dict[str, Any], of: str = "before", avoidable: bool = False
) -> float | None:
    """Returns the fraction of the true error that a learned function removes, in tested trials.

    The true error is the rms difference between predicted and true readings. The mean over the
    channels is weighted by the inverse noise floors. `of` is the model whose error is 1: the model
    "before" the function, or the calibrated model without any effect, "refit". If `avoidable` is
    true, the squared error of a calibrated complete model is subtracted from both squared errors.
    None: nothing was learned, or the result file of an earlier version does not contain this model.
    """
    learned = case.get("learned", {})
    before, after, complete = (
        sum(
            (x.get(key, 0.0) / learned["errors"][c]["floor"]) ** 2
            for c, x in learned.get("distance", {}).items()
        )
        for key in (of, "after", "complete")
    )
    if avoidable and complete == 0.0:
        return None
    unavoidable = complete if avoidable else 0.0
    if before <= unavoidable:
        return None
    return 1.0 - float(np.sqrt(max(after - unavoidable, 0.0) / (before - unavoidable)))


def _share(flags: Sequence[bool]) -> str:
    return f"{sum(flags)} of {len(flags)} ({np.mean(flags):.0%})" if flags else "none"


def _coverage(found: Sequence[dict[str, Any]], key: str) -> list[bool]:
    """Returns whether each interval under `key` contains the true value."""
    return [v["low"] < v["truth"] < v["high"] for x in found for v in x.get(key, {}).values()]


def summary_tables(out: Path) -> str:
    """Returns all tables as Markdown, and the digest of the results."""
    parts = []
    nulls, noisy = read_cases(out, "null"), read_cases(out, "noise")
    if nulls or noisy:
        parts.append(_null_table(nulls, noisy))
    situations = read_cases(out, "situation")
    if situations:
        parts.append(_situation_table(situations))
    singles, doubles = read_cases(out, "single"), read_cases(out, "double")
    if singles:
        parts.append(_single_table(singles))
    eight = {kind: read_cases(out, kind) for kind in ("single8", "double8")}
    if eight["single8"]:
        parts.append("Single effects, eight trials:\n\n" + _single_table(eight["single8"]))
    for title, pairs in (("Two effects", doubles), ("Pairs, eight trials", eight["double8"])):
        if pairs:
            empty = sum(not x["effects"] for x in pairs)
            lines = [f"{title}, {len(pairs)} pairs: F1 {f1(pairs):.3f}; {empty} empty models"]
            parts.append("\n".join([*lines, *(_case_line(x) for x in pairs)]))
    outside = []
    for kind in LACKING:
        found = read_cases(out, kind)
        outside += found
        if found:
            parts.append(_outside_table(kind, found))
    skill = skills(x for x in (*singles, *doubles) if named_causes(x))
    if skill:
        parts.append(
            f"Held-out skill in {len(skill)} cases with a named effect: median "
            f"{np.median(skill):.3f}, smallest {min(skill):.3f}"
        )
    parts.append(_method_table([*nulls, *singles, *doubles, *outside]))
    everything = [*nulls, *noisy, *situations, *singles, *doubles, *outside]
    everything += [x for found in eight.values() for x in found]
    seconds = [x["seconds"] for x in everything]
    parts.append(
        f"{len(everything)} tanks, {np.median(seconds):.0f} s at the median, "
        f"{max(seconds):.0f} s at most. SHA-256 of all results: {results_digest(out)}"
    )
    return "\n\n".join(x for x in parts if x)


def results_digest(out: Path) -> str:
    """Returns the SHA-256 digest of all result files, in the order of their names."""
    digest = hashlib.sha256()
    for path in sorted(out.glob("*/*.json")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _null_table(nulls: Sequence[dict[str, Any]], noisy: Sequence[dict[str, Any]]) -> str:
    """Returns the number of false alarms, and the coverage of the base parameters' intervals."""
    lines = [
        "| noise | tanks | a named effect | another verdict than nothing missing |",
        "|---|---|---|---|",
    ]
    groups: dict[str, list[dict[str, Any]]] = {}
    for x in (*nulls, *noisy):
        groups.setdefault(x["case"]["noise"], []).append(x)
    for noise, found in groups.items():
        named = _share([bool(named_causes(x)) for x in found])
        other = _share([x["verdict"] != NOTHING for x in found])
        lines.append(f"| {noise} | {len(found)} | {named} | {other} |")
    lines.append("")
    wrong = [x for x in (*nulls, *noisy) if x["verdict"] != NOTHING]
    lines += [_case_line(x) for x in wrong]
    if nulls:
        lines += ["", "Intervals of the base parameters that contain the truth:"]
        for name in nulls[0]["parameters"]:
            own = [{"parameters": {name: x["parameters"][name]}} for x in nulls]
            lines.append(f"- {name}: {_share(_coverage(own, 'parameters'))}")
        lines.append(f"- all: {_share(_coverage(nulls, 'parameters'))}")
    return "\n".join(lines)


def _situation_table(found: Sequence[dict[str, Any]]) -> str:
    """Returns the verdicts in each situation, without a missing effect and with one."""
    lines = [
        "| situation | complete models: a named effect | another verdict than nothing missing "
        "| one effect: correct |",
        "|---|---|---|---|",
    ]
    for situation in dict.fromkeys(x["case"]["noise"] for x in found):
        own = [x for x in found if x["case"]["noise"] == situation]
        nulls = [x for x in own if not x["case"]["effects"]]
        named = _share([bool(named_causes(x)) for x in nulls])
        other = _share([x["verdict"] != NOTHING for x in nulls])
        right = _share([is_right(x) for x in own if x["case"]["effects"]])
        lines.append(f"| {situation} | {named} | {other} | {right} |")
    wrong = [x for x in found if x["case"]["effects"] and not is_right(x)]
    wrong += [x for x in found if not x["case"]["effects"] and x["verdict"] != NOTHING]
    return "\n".join([*lines, "", *(_case_line(x) for x in wrong)])


def _single_table(singles: Sequence[dict[str, Any]]) -> str:
    lines = [
        "| size divided by detection limit | correct | correct, without equivalent effects "
        "| true effect in the model | mean number of effects in a class | median skill "
        "| smallest skill |",
        "|---|---|---|---|---|---|---|",
    ]
    for size in sorted({x["case"]["size"] for x in singles}):
        of = [x for x in singles if x["case"]["size"] == size]
        sizes = [len(c) for x in of for c in named_causes(x)]
        skill = skills(x for x in of if named_causes(x)) or [np.nan]
        kept = [
            any(matched_effects([{e["name"], *e["class"]}], x["case"]["effects"]) for e in own)
            for x in of
            for own in [x["effects"]]
        ]
        lines.append(
            f"| {size:g} | {_share([is_right(x) for x in of])} "
            f"| {_share([is_right(x, most=1) for x in of])} | {_share(kept)} "
            f"| {np.mean(sizes or [0]):.2f} | {np.median(skill):.3f} | {min(skill):.3f} |"
        )
    inside = _coverage([x for x in singles if is_right(x)], "effects_cover")
    lines += ["", f"The interval of an effect's parameter contains the truth: {_share(inside)}"]
    return "\n".join([*lines, "", *(_case_line(x) for x in singles if not is_right(x))])


def _outside_table(kind: str, outside: Sequence[dict[str, Any]]) -> str:
    ratings = [rated_location(x) for x in outside]
    lines = [f"{len(ratings)} tanks of the kind {kind}, with effects that the library lacks:"]
    lines += [f"- {x}: {ratings.count(x)}" for x in sorted(set(ratings))]
    shares = [removed_error(x) for x in outside]
    learned = [x is not None for x in shares]
    lines.append(f"- a function was learned: {_share(learned)}")
    enough = [x is not None and x >= REMOVED for x in shares]
    lines.append(
        f"- it removes {REMOVED:.0%} of the true error in held-out trials: {_share(enough)}"
    )
    whole = [removed_error(x, "refit") for x in outside]
    enough = [x is not None and x >= REMOVED for x in whole]
    lines.append(f"- the same, with the corrections beside it: {_share(enough)}")
    avoidable = [removed_error(x, avoidable=True) for x in outside]
    if any(x is not None for x in avoidable):
        enough = [x is not None and x >= REMOVED for x in avoidable]
        lines.append(f"- the same, without the error of a complete model: {_share(enough)}")
    for rating, share, x in zip(ratings, shares, outside, strict=True):
        removed = "nothing learned" if share is None else f"{share:.0%} of the true error removed"
        lines.append(f"{_case_line(x)}: {rating}, {removed}")
    return "\n".join(lines)


def _case_line(x: dict[str, Any]) -> str:
    case = x["case"]
    effects = ", ".join("/".join([e["name"], *e["class"]]) for e in x["effects"]) or "no effect"
    return (
        f"- {case['name']} (tank {case['seed']}): {x['verdict']}, {effects}, {x['seconds']:.0f} s"
    )


def _method_table(found: Sequence[dict[str, Any]]) -> str:
    """Returns the table of all methods on the tanks in which all methods ran."""
    found = [x for x in found if x.get("named_by")]
    if not found:
        return ""
    kinds = {k: [x for x in found if x["case"]["kind"] == k] for k in ("null", "single", "double")}
    methods = dict.fromkeys(m for x in found for m in x["held_out_over_floor"])
    lines = [
        f"All methods ran on {len(found)} tanks: "
        + ", ".join(f"{len(x)} {kind}" for kind, x in kinds.items()),
        "",
        "| method | names an effect in a null tank | one effect, correct | two effects, F1 score "
        "| median skill | smallest skill |",
        "|---|---|---|---|---|---|",
    ]
    for method in methods:
        skill = skills(found, method) or [np.nan]
        named = method in ("loop", *NAMING)
        alarms = _share([bool(named_causes(x, method)) for x in kinds["null"]]) if named else ""
        one = _share([is_right(x, method) for x in kinds["single"]]) if named else ""
        two = f"{f1(kinds['double'], method):.2f}" if named and kinds["double"] else ""
        lines.append(
            f"| {method} | {alarms} | {one} | {two} | {np.median(skill):.2f} | {min(skill):.2f} |"
        )
    return "\n".join(lines)
