"""The outcome as report.json and model.toml."""

from typing import Any

import numpy as np

from calibration.discrepancy.close_loop import Errors, LoopOutcome
from calibration.discrepancy.localise import locate_residuals
from calibration.discrepancy.rounds import SelectionStep
from calibration.discrepancy.verdict import at_bounds, split
from calibration.inference.goodness import FLOOR
from calibration.model.extended import base_values
from calibration.reporting.parameters import parameter_record, parameter_text, parameter_toml
from slider_jax.channels import CHANNELS
from slider_jax.effects.library import LIBRARY
from slider_jax.io.files import versions


def loop_record(
    outcome: LoopOutcome,
    seconds: float,
    source: dict[str, Any],
    following: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """The content of report.json; `source` names the input, `following` the next experiment."""
    held = outcome.held_out
    trials, given = outcome.problem.records, base_values(outcome.experiment)
    return {
        "verdict": outcome.verdict,
        "said": verdict_text(outcome),
        "effects": effect_records(outcome),
        "nearest": nearest_effects(outcome),
        "parameters": {
            p.name: _interval(outcome, "", p.name)
            | {"given": given[p.name], "without_effects": outcome.search.base.theta[i]}
            for i, p in enumerate(outcome.entries)
            if not p.effect and i in outcome.final.free
        },
        "errors": _table(outcome.used),
        "held_out": _table(held) if held else {},
        "held_out_trials": [trials[i].trial.file for i in outcome.held],
        "candidates": candidate_records(outcome),
        "unexplained": residual_records(outcome),
        "audit": [x.told() for x in outcome.audit],
        "next_experiment": following,
        "units": {name: CHANNELS[name].unit for name in CHANNELS},
        "left_over_noise": {c: np.sqrt(x.all) for c, x in outcome.excess_after.items()},
        "seconds": seconds,
        "input": source,
        "versions": versions(),
        "settings": outcome.experiment.model_dump(),
    }


def effect_records(outcome: LoopOutcome) -> list[dict[str, Any]]:
    """Every effect that was added, what it cannot be told from, its rivals and parameters."""
    found = []
    for this in outcome.search.rounds:
        if this.chosen is None or this.chosen not in outcome.effects:
            continue
        kind = LIBRARY[this.chosen]
        tried = next(t for t in this.tried if t.name == this.chosen)
        found.append(
            {
                "name": this.chosen,
                "title": kind.title,
                "class": _class(outcome, this),
                "in_place_of": this.replaced,
                "rivals": [
                    {"name": n, "loss": x.loss, "channels": x.sizes, "told_apart": x.is_worse}
                    for n, x in this.rivals.items()
                ],
                "parameters": {p: _interval(outcome, this.chosen, p) for p in kind.priors()},
                "where": kind.place(),
                "channels": {c: share for c, share in tried.sizes.items() if share > 1e-4},
                "gain": tried.gain,
            }
        )
    return found


def nearest_effects(outcome: LoopOutcome) -> list[dict[str, Any]]:
    """Effects that came nearest to a residual that none explains; they are not in the model."""
    names = [] if outcome.effects else outcome.search.effects
    return [{"name": n, "title": LIBRARY[n].title, "where": LIBRARY[n].place()} for n in names]


def _class(outcome: LoopOutcome, this: SelectionStep) -> list[str]:
    """What an added effect cannot be told from: rivals, and what it may share its cause with."""
    left = any(x.all > FLOOR for x in outcome.excess_after.values())
    parts = split(outcome.search) if left else []
    return this.alike + [n for n in parts if this.chosen in parts and n != this.chosen]


def _interval(outcome: LoopOutcome, effect: str, name: str) -> dict[str, Any]:
    index = next(i for i, p in enumerate(outcome.entries) if (p.effect, p.name) == (effect, name))
    return parameter_record(outcome.final, outcome.entries, index)


def _table(errors: Errors) -> dict[str, dict[str, float]]:
    return {
        c: {"before": errors.before[c], "after": errors.after[c], "floor": errors.floor[c]}
        for c in errors.before
    }


def candidate_records(outcome: LoopOutcome) -> list[dict[str, Any]]:
    """All candidates of all rounds, best first, and why each was left."""
    rows = []
    for number, this in enumerate(outcome.search.rounds, start=1):
        tried = {t.name: t for t in this.tried}
        for s in this.scores:
            row = {"round": number, "name": s.name, "score": s.gain, "p": s.p}
            if s.name in tried:
                t = tried[s.name]
                row |= {"explained": t.gain, "sizes": t.sizes, "worth_naming": t.worth_naming}
                row["left_out_trials_agree"], row["left_out_trials_chance"] = t.agreement
            rows.append(row | {"chosen": s.name == this.chosen})
    return rows


def residual_records(outcome: LoopOutcome) -> list[dict[str, Any]]:
    """Where the residual of the last fit stands above the floor on the trials it was fitted to."""
    seen = [r for i, r in enumerate(outcome.problem.records) if i not in outcome.held]
    return locate_residuals(seen, outcome.chosen.predicted, outcome.excess_after)


def verdict_text(outcome: LoopOutcome) -> str:
    """The verdict in a sentence."""
    names = outcome.search.effects
    titles = ", ".join(f"{LIBRARY[n].title} ({n})" for n in names)
    match outcome.verdict:
        case "nothing_missing":
            return "Nothing is missing at the precision of these data: the residual is noise."
        case "identified":
            return f"The model lacked: {titles}."
        case "class":
            rivals = ", ".join(n for e in effect_records(outcome) for n in e["class"])
            return (
                f"The model lacked: {titles}; these data cannot tell "
                f"{'it' if len(names) == 1 else 'these'} from {rivals}."
            )
        case "unexplained":
            channels = ", ".join(c for c, x in outcome.excess_after.items() if x.all > FLOOR)
            said = "Something is missing"
            said += f" in {channels}" if channels else ""
            said += ", and none of the candidates explains it."
            edge = at_bounds(outcome.search, outcome.entries)
            if edge:
                said += f" At the edge of what is believed of it: {', '.join(edge)}."
            elif names:
                said += f" The nearest, {titles}, leaves too much of it."
            return said
    if not outcome.search.final.converged:
        return "Inconclusive: the last fit did not converge."
    return "Inconclusive: a candidate explains more than chance, but the trials do not agree on it."


def parameter_lines(told: dict[str, Any]) -> list[str]:
    """A line for each parameter of what was added."""
    lines = []
    for effect in told["effects"]:
        for name, x in effect["parameters"].items():
            lines.append(f"{effect['name']}.{name} = {parameter_text(x)}")
    return lines


def error_lines(told: dict[str, Any]) -> list[str]:
    """A line for each channel's error on the trials held out, or where none was, on all."""
    errors, of = told["held_out"] or told["errors"], "held out" if told["held_out"] else "all"
    return [
        f"{c}, trials {of}: rms {x['before']:.3g} before, {x['after']:.3g} after, "
        f"floor {x['floor']:.3g} {told['units'][c]}"
        for c, x in errors.items()
    ]


def loop_model_toml(outcome: LoopOutcome) -> str:
    """The calibrated model with its effects, for `slider simulate --model`."""
    final = outcome.final
    return parameter_toml(
        verdict_text(outcome), outcome.entries, final.theta, outcome.effects, final.free
    )
