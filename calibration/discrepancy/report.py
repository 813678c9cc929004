"""Writes the loop's outcome as report.json, model.toml and text."""

from dataclasses import asdict
from typing import Any

import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome
from calibration.discrepancy.localise import locate_residuals
from calibration.discrepancy.verdict import effects_at_bounds, effects_at_same_place
from calibration.model.extended import base_values
from calibration.reporting.parameters import model_tables, parameter_record, parameter_text
from slider_jax.channels import CHANNELS
from slider_jax.effects.library import LIBRARY
from slider_jax.io.files import provenance
from slider_jax.io.toml import toml_text


def loop_record(
    outcome: LoopOutcome,
    seconds: float,
    source: dict[str, Any],
    following: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Returns the content of report.json; `source` is the input, `following` the next trial."""
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
        "errors": outcome.used,
        "held_out": outcome.held_out,
        "held_out_trials": [trials[i].trial.file for i in outcome.held],
        "candidates": candidate_records(outcome),
        "unexplained": residual_records(outcome),
        "audit": [x._asdict() for x in outcome.audit],
        "next_experiment": following,
        "units": {name: CHANNELS[name].unit for name in CHANNELS},
        "left_over_noise": {c: np.sqrt(x.all) for c, x in outcome.excess.items()},
        "seconds": seconds,
        "input": source,
        **provenance(),
        "settings": outcome.experiment.model_dump(),
        "selection_settings": asdict(outcome.search.settings),
    }


def effect_records(outcome: LoopOutcome) -> list[dict[str, Any]]:
    """Returns every added effect with its equivalence class, alternatives and parameters."""
    found, settings = [], outcome.search.settings
    same_place = effects_at_same_place(outcome.search) if _above_floor(outcome) else []
    for round_ in outcome.search.rounds:
        if round_.chosen is None or round_.chosen not in outcome.effects:
            continue
        parts = same_place if round_.chosen in same_place else []
        kind = LIBRARY[round_.chosen]
        refit = next(t for t in round_.refitted if t.name == round_.chosen)
        found.append(
            {
                "name": round_.chosen,
                "title": kind.title,
                "class": round_.equivalent + [n for n in parts if n != round_.chosen],
                "in_place_of": round_.replaced,
                "rivals": [
                    {
                        "name": n,
                        "loss": x.loss,
                        "channels": x.sizes,
                        "told_apart": settings.worth_naming(x.loss, x.sizes),
                    }
                    for n, x in round_.alternatives.items()
                ],
                "parameters": {p: _interval(outcome, round_.chosen, p) for p in kind.priors()},
                "where": kind.place(),
                "channels": {c: share for c, share in refit.sizes.items() if share > 1e-4},
                "gain": refit.gain,
            }
        )
    return found


def nearest_effects(outcome: LoopOutcome) -> list[dict[str, Any]]:
    """Returns the selected effects if the verdict does not name them, or else an empty list."""
    names = [] if outcome.effects else outcome.search.effects
    return [{"name": n, "title": LIBRARY[n].title, "where": LIBRARY[n].place()} for n in names]


def _above_floor(outcome: LoopOutcome) -> list[str]:
    """Returns the channels whose residual exceeds the noise floor."""
    floor = outcome.search.settings.noise_floor
    return [c for c, x in outcome.excess.items() if x.all > floor]


def _interval(outcome: LoopOutcome, effect: str, name: str) -> dict[str, Any]:
    index = next(i for i, p in enumerate(outcome.entries) if (p.effect, p.name) == (effect, name))
    return parameter_record(outcome.final, outcome.entries, index)


def candidate_records(outcome: LoopOutcome) -> list[dict[str, Any]]:
    """Returns the candidates of each round, best first, with the test results of refitted ones."""
    rows = []
    for number, round_ in enumerate(outcome.search.rounds, start=1):
        refitted = {t.name: t for t in round_.refitted}
        for s in round_.scores:
            row = {"round": number, "name": s.name, "score": s.gain, "p": s.p}
            if s.name in refitted:
                t = refitted[s.name]
                row |= {"explained": t.gain, "sizes": t.sizes, "worth_naming": t.worth_naming}
                row["left_out_trials_agree"], row["left_out_trials_chance"] = t.agreement
            rows.append(row | {"chosen": s.name == round_.chosen})
    return rows


def residual_records(outcome: LoopOutcome) -> list[dict[str, Any]]:
    """Returns the records of `locate_residuals` for the trials that were not held out."""
    fitted = [r for i, r in enumerate(outcome.problem.records) if i not in outcome.held]
    floor = outcome.search.settings.noise_floor
    return locate_residuals(fitted, outcome.chosen.predicted, outcome.excess, floor)


def verdict_text(outcome: LoopOutcome) -> str:
    """Returns the verdict as a sentence."""
    names = outcome.search.effects
    titles = ", ".join(f"{LIBRARY[n].title} ({n})" for n in names)
    match outcome.verdict:
        case "nothing_missing":
            return "No effect is missing at the precision of these data: the residual is noise."
        case "identified":
            return f"The model lacked: {titles}."
        case "class":
            others = ", ".join(n for e in effect_records(outcome) for n in e["class"])
            return (
                f"The model lacked: {titles}. These data cannot discriminate between "
                f"{'this effect' if len(names) == 1 else 'these effects'} and {others}."
            )
        case "unexplained":
            channels = ", ".join(_above_floor(outcome))
            text = "The model lacks an effect"
            text += f" in {channels}" if channels else ""
            text += ", and no candidate explains the residual."
            edge = effects_at_bounds(outcome.search, outcome.entries)
            if edge:
                text += f" A parameter is at a bound of its prior range: {', '.join(edge)}."
            elif names:
                text += f" With the best candidate, {titles}, the residual is still too large."
            return text
    if not outcome.search.final.converged:
        return "Inconclusive: the final fit did not converge."
    return "Inconclusive: a candidate has a significant gain, but fails the cross-validation."


def parameter_lines(record: dict[str, Any]) -> list[str]:
    """Returns a line for each parameter of the added effects."""
    return [
        f"{effect['name']}.{name} = {parameter_text(x)}"
        for effect in record["effects"]
        for name, x in effect["parameters"].items()
    ]


def error_lines(record: dict[str, Any]) -> list[str]:
    """Returns a line for each channel's error in held-out trials, or in all if none is held out."""
    held = record["held_out"]
    errors, trials = held or record["errors"], "held-out trials" if held else "all trials"
    return [
        f"{c}, {trials}: rms {x['before']:.3g} before, {x['after']:.3g} after, "
        f"noise floor {x['floor']:.3g} {record['units'][c]}"
        for c, x in errors.items()
    ]


def loop_model_toml(outcome: LoopOutcome) -> str:
    """Returns the calibrated model with its effects, for `slider simulate --model`."""
    entries, final = outcome.entries, outcome.final
    kept = [i for i, p in enumerate(entries) if p.effect or i in final.free]
    tables = model_tables([entries[i] for i in kept], final.theta[kept], outcome.effects)
    return toml_text(tables, verdict_text(outcome))
