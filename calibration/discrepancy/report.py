"""Writes the loop's outcome as report.json, model.toml and text."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome
from calibration.discrepancy.localise import locate_residuals
from calibration.discrepancy.ranges import at_edge
from calibration.discrepancy.verdict import (
    INCONCLUSIVE,
    NOTHING,
    UNEXPLAINED,
    EffectStatus,
    channels_above_floor,
)
from calibration.inference.whiteness import SeriesTest
from calibration.model.extended import base_values
from calibration.reporting.parameters import model_tables, parameter_record, parameter_text
from slider_jax.channels import Channel
from slider_jax.effects.library import LIBRARY
from slider_jax.io.files import provenance
from slider_jax.io.toml import toml_text

REPEATABLE_RATIO = 1.3
"""The report states a repeatable error of the thrust if the error exceeds this multiple of the
discrepancy's lower limit. This is about twice the extrapolated discretisation error."""
REPEATABLE_ERRORS = 2.0
"""The report states a repeatable error of the thrust if it exceeds the discrepancy's lower limit by
more than this number of standard errors. A declared discrepancy has no standard error."""


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
        "vetoed": veto_records(outcome),
        "residual": residual_record(outcome),
        "nearest": [],
        "parameters": {
            p.name: _interval(outcome, "", p.name)
            | {"given": given[p.name], "without_effects": outcome.search.base.theta[i]}
            for i, p in enumerate(outcome.entries)
            if not p.effect and i in outcome.final.free
        },
        "instability": [x._asdict() for x in outcome.unstable],
        "noise": {c: x._asdict() for c, x in outcome.noise.items()},
        "discrepancy": discrepancy_records(outcome),
        "whiteness": whiteness_record(outcome),
        "errors": outcome.used,
        "held_out": outcome.held_out,
        "held_out_trials": [trials[i].trial.file for i in outcome.held],
        "candidates": candidate_records(outcome),
        "unexplained": residual_records(outcome),
        "audit": [x._asdict() for x in outcome.audit],
        "next_experiment": following,
        "learned": None,
        "units": {name: x.unit for name, x in outcome.problem.all_channels.items()},
        "left_over_noise": {c: np.sqrt(x.all) for c, x in outcome.excess.items()},
        "seconds": seconds,
        "input": source,
        **provenance(),
        "settings": outcome.experiment.model_dump(),
        "selection_settings": asdict(outcome.search.settings),
    }


def effect_records(outcome: LoopOutcome) -> list[dict[str, Any]]:
    """Returns every added effect with its status, alternatives and parameters."""
    found, settings = [], outcome.search.settings
    for x in outcome.statuses:
        round_ = next(r for r in outcome.search.rounds if r.chosen == x.name)
        kind = LIBRARY[x.name]
        refit = next(t for t in round_.refitted if t.name == x.name)
        found.append(
            {
                "name": x.name,
                "title": kind.title,
                "status": x.status,
                "class": x.equivalent,
                "above_floor": x.above_floor,
                "includes_null": x.includes_null,
                "beyond_prior": [_beyond_record(outcome, i) for i in x.beyond],
                "in_place_of": round_.replaced,
                "rivals": [
                    {
                        "name": n,
                        "loss": a.loss,
                        "channels": a.sizes,
                        "told_apart": a.is_excluded(settings),
                        "parameters": {
                            outcome.entries[i].label: float(a.fit.theta[i]) for i in a.fit.free
                        },
                    }
                    for n, a in round_.alternatives.items()
                ],
                "parameters": {
                    p: _interval(outcome, x.name, p) for p in kind.priors() | kind.shapes()
                },
                "where": kind.place(),
                "segments": list(kind.segments),
                "channels": {c: share for c, share in refit.sizes.items() if share > 1e-4},
                "gain": refit.gain,
            }
        )
    return found


def _beyond_record(outcome: LoopOutcome, index: int) -> dict[str, Any]:
    """Returns a parameter's declared prior range with its reason, and the range of the fit."""
    search, p = outcome.search, outcome.entries[index]
    declared, value = search.declared[index], float(outcome.final.theta[index])
    return {
        "parameter": p.name,
        "value": value,
        "unit": p.prior.unit,
        "range": [declared.low, declared.high],
        "why": declared.why,
        "widened_range": [p.prior.low, p.prior.high],
        "at_edge_of_widened_range": at_edge(value, p.prior, search.settings.bound_margin),
    }


def veto_records(outcome: LoopOutcome) -> list[dict[str, Any]]:
    """Returns the selected effects that were removed because they increase the held-out error."""
    return [
        {"name": n, "title": LIBRARY[n].title, "log_growth": x.mean, "standard_error": x.error}
        for n, x in outcome.search.vetoed.items()
    ]


def residual_record(outcome: LoopOutcome) -> dict[str, Any]:
    """Returns the second part of the verdict: the status and the pattern of the residual.

    `where` and `pattern` are None for channels whose residual is at the noise floor.
    """
    located = {x["channel"]: x for x in residual_records(outcome)}
    channels: dict[str, Any] = {}
    for channel, x in outcome.excess.items():
        channels[channel] = {"mean_square": x.all, "where": None, "pattern": None}
        if channel in located:
            here = located[channel]
            settings = ("frequency_Hz", "amplitude_Pa", "tow_speed_m_per_s")
            channels[channel] |= {
                "where": {"trial": here["worst_trial"]} | {n: here[n] for n in settings},
                "pattern": here["in_worst_trial"] | {"grows_with": here["grows_with"]},
            }
    return {"status": "above_floor" if located else "at_floor", "channels": channels}


def _interval(outcome: LoopOutcome, effect: str, name: str) -> dict[str, Any]:
    index = next(i for i, p in enumerate(outcome.entries) if (p.effect, p.name) == (effect, name))
    return parameter_record(outcome.final, outcome.entries, index)


def candidate_records(outcome: LoopOutcome) -> list[dict[str, Any]]:
    """Returns the candidates of each round, best first, with the tests of refitted candidates."""
    rows = []
    for number, round_ in enumerate(outcome.search.rounds, start=1):
        refitted = {t.name: t for t in round_.refitted}
        for s in round_.scores:
            row = {"round": number, "name": s.name, "score": s.gain, "p": s.p}
            if s.name in refitted:
                t = refitted[s.name]
                row |= {"explained": t.gain, "sizes": t.sizes, "worth_naming": t.worth_naming}
                row |= {"left_out_trials_agree": t.agreement.t}
                row |= {"left_out_trials_chance": t.agreement.rank_chance}
                row |= {"left_out_trials_t_chance": t.agreement.t_chance}
                for key, gain in (
                    ("left_out_trials_least_gain", t.agreement.least_gain),
                    ("left_out_trials_rest_gain", t.agreement.rest_gain),
                ):
                    row |= {key: gain if np.isfinite(gain) else None}
            rows.append(row | {"chosen": s.name == round_.chosen})
    return rows


def residual_records(outcome: LoopOutcome) -> list[dict[str, Any]]:
    """Returns the records of `locate_residuals` for the trials that were not held out."""
    fitted = [outcome.problem.records[i] for i in outcome.used_trials]
    floor = outcome.search.settings.noise_floor
    return locate_residuals(fitted, outcome.chosen.predicted, outcome.excess, floor)


def verdict_text(outcome: LoopOutcome) -> str:
    """Returns both parts of the verdict as sentences: the effects, then the residual."""
    return " ".join(verdict_sentences(outcome))


def verdict_sentences(outcome: LoopOutcome) -> list[str]:
    """Returns the sentences of `verdict_text`."""
    return [
        *_opening(outcome),
        *effect_sentences(outcome),
        *veto_sentences(outcome),
        residual_sentence(outcome),
        *instability_sentences(outcome),
        *noise_sentences(outcome),
        *discrepancy_sentences(outcome),
    ]


def _opening(outcome: LoopOutcome) -> list[str]:
    if outcome.verdict == NOTHING:
        return ["No effect is missing at the precision of these data."]
    if outcome.verdict == UNEXPLAINED:
        channels = ", ".join(channels_above_floor(outcome.excess, outcome.search.settings))
        return [f"The model lacks an effect in {channels}, and no candidate explains the residual."]
    if not outcome.search.final.converged:
        opening = "Inconclusive: the" if outcome.verdict == INCONCLUSIVE else "The"
        return [f"{opening} final fit did not converge."]
    if outcome.verdict != INCONCLUSIVE:
        return []
    if outcome.statuses:
        return ["Inconclusive: no added effect is certain."]
    if outcome.search.vetoed:
        return ["Inconclusive: the held-out trials contradict the selected effect."]
    return ["Inconclusive: a candidate has a significant gain, but fails the cross-validation."]


def effect_sentences(outcome: LoopOutcome) -> list[str]:
    """Returns the first part of the verdict: which effects are causes, and which corrections."""
    found, text = outcome.statuses, []
    corrections = [x for x in found if x.is_correction]
    causes = [x for x in found if not x.is_correction]
    if causes:
        text.append(f"The model lacked: {_titles(causes)}.")
    if corrections:
        one = len(corrections) == 1
        as_, these = ("a correction", "The effect") if one else ("corrections", "These effects")
        text.append(f"As {as_}, the loop's model contains: {_titles(corrections)}.")
        above = [x for x in corrections if x.above_floor]
        if above:
            channels = ", ".join(dict.fromkeys(c for x in above for c in x.above_floor))
            who = these if above == corrections else " and ".join(x.name for x in above)
            text.append(
                f"{who} may only resemble the cause, because the residual of {channels} is not "
                "only noise."
            )
        if outcome.replaceable:
            text.append(
                f"{these} may only resemble the cause, because a learned function explains the "
                "data better, or as well with fewer terms."
            )
    for x in found:
        if x.includes_null:
            text.append(
                f"The effect {x.name} may be absent: the 95 % interval of its size includes the "
                "null."
            )
        if x.equivalent:
            others = ", ".join(x.equivalent)
            text.append(f"These data cannot discriminate between {x.name} and {others}.")
            text += dependence_sentences(outcome, x)
        text += [_beyond_sentence(x.name, _beyond_record(outcome, i)) for i in x.beyond]
    return text


def _titles(effects: Sequence[EffectStatus]) -> str:
    return "; ".join(
        f"{LIBRARY[x.name].title} ({x.name})"
        + (f", or instead {' or '.join(x.equivalent)}" if x.equivalent else "")
        for x in effects
    )


def dependence_sentences(outcome: LoopOutcome, x: EffectStatus) -> list[str]:
    """Returns a sentence on each base parameter whose value depends on which effect is the cause.

    An equivalent effect can give a base parameter a value outside the 95 % interval of the final
    model, because the interval assumes that the chosen effect is the cause.
    """
    round_ = next(r for r in outcome.search.rounds if r.chosen == x.name)
    text = []
    for i, p in enumerate(outcome.entries):
        if p.effect or i not in outcome.final.free:
            continue
        value, low, high = outcome.interval(i)
        unit = "" if p.prior.unit == "-" else f" {p.prior.unit}"
        others = [
            f"{a.fit.theta[i]:.4g}{unit} with {name}"
            for name, a in round_.alternatives.items()
            if name in x.equivalent and i in a.fit.free and not low <= a.fit.theta[i] <= high
        ]
        if others:
            text.append(
                f"{p.name} depends on which effect is the cause: {value:.4g}{unit} with {x.name}, "
                f"{', '.join(others)}."
            )
    return text


def _beyond_sentence(name: str, x: dict[str, Any]) -> str:
    unit = "" if x["unit"] == "-" else f" {x['unit']}"
    low, high = x["range"]
    text = (
        f"{name}.{x['parameter']} = {x['value']:.4g}{unit} is outside its prior range of {low:.4g} "
        f"to {high:.4g}{unit} ({x['why']})."
    )
    if x["at_edge_of_widened_range"]:
        low, high = x["widened_range"]
        text += (
            f" The value is also at an edge of the wider range of the fit, {low:.4g} to "
            f"{high:.4g}{unit}."
        )
    return text


def veto_sentences(outcome: LoopOutcome) -> list[str]:
    """Returns a sentence on each effect that the held-out trials contradict."""
    return [
        f"The selected effect {name} ({LIBRARY[name].title}) was removed, because it increases the "
        f"sum of squares in the held-out trials by {100.0 * np.expm1(x.mean):.3g} %."
        for name, x in outcome.search.vetoed.items()
    ]


def choice_sentence(choice: Mapping[str, Any]) -> str:
    """Returns a sentence if the search was restricted to a part of the candidates, or ""."""
    if choice["tested"] == choice["known"]:
        return ""
    options = [f"--{x} {' '.join(choice[x])}" for x in ("only", "without") if choice[x]]
    return (
        f"Only {choice['tested']} of {choice['known']} candidates were tested "
        f"({', '.join(options)}). Other effects may fit equally well."
    )


def residual_sentence(outcome: LoopOutcome) -> str:
    """Returns the second part of the verdict: the channels whose residual is not only noise."""
    above = channels_above_floor(outcome.excess, outcome.search.settings)
    if not above:
        return "The residual is at the noise floor."
    fitted = [outcome.problem.records[i] for i in outcome.used_trials]
    large, patterned = list[str](), list[str]()
    for c in above:
        x, text = outcome.excess[c], []
        is_large = x.all > outcome.search.settings.noise_floor
        if is_large:
            worst = fitted[int(np.nanargmax(x.trials))].trial.file
            text.append(f"mean square {x.all:.3g} times the noise variance, largest in {worst}")
        if x.patterns:
            channel = outcome.problem.all_channels[c]
            text.append(pattern_text(channel, max(x.patterns, key=lambda p: p.line)))
        (large if is_large else patterned).append(f"{c} ({'; '.join(text)})")
    sentences = []
    if large:
        sentences.append(f"The residual is above the noise floor in {', '.join(large)}.")
    if patterned:
        sentences.append(
            f"The residual is as small as the noise, but is not white noise, in "
            f"{', '.join(patterned)}."
        )
    return " ".join(sentences)


def pattern_text(channel: Channel, x: SeriesTest) -> str:
    """Returns what a test of whiteness of a `channel` found: a sine, or correlated readings."""
    if not x.has_line:
        return (
            f"{x.trial} has a correlated residual, with a sum of squared autocorrelations of "
            f"{x.correlation:.2g}"
        )
    factor, unit = channel.plot_factor, channel.plot_unit
    return (
        f"{x.trial} has a sine of {x.frequency_Hz:.3g} Hz with an amplitude of "
        f"{factor * x.amplitude:.3g} {unit}"
    )


def whiteness_record(outcome: LoopOutcome) -> dict[str, Any]:
    """Returns the tests of whiteness: the worst trial of each channel, and all failed tests."""
    tested = {c: x.series for c, x in outcome.excess.items() if x.series}
    return {
        "series": sum(len(x) for x in tested.values()),
        "channels": {
            c: {
                "correlation": max(x, key=lambda s: s.correlation)._asdict(),
                "line": max(x, key=lambda s: s.line)._asdict(),
            }
            for c, x in tested.items()
        },
        "patterns": [
            p._asdict() | {"has_line": p.has_line, "correlated": p.correlated}
            for x in outcome.excess.values()
            for p in x.patterns
        ],
    }


def instability_sentences(outcome: LoopOutcome) -> list[str]:
    """Returns a sentence on each parameter that differs between two halves of the trials."""
    return [
        f"{x.name} is {x.first:.4g} in the first half of the trials and {x.second:.4g} in the "
        f"second half. The difference is {x.sigma:.2g} standard errors."
        for x in outcome.unstable
    ]


def noise_sentences(outcome: LoopOutcome) -> list[str]:
    """Returns a sentence on each channel whose noise differs from the declared noise."""
    text, channels = [], outcome.problem.all_channels
    for c, x in outcome.noise.items():
        factor, unit = channels[c].plot_factor, channels[c].plot_unit
        if x.replaced and x.declared is not None and x.measured is not None:
            text.append(
                f"The declared white noise of {c} is {factor * x.declared:.3g} {unit}, but the "
                f"measured white noise is {factor * x.measured:.3g} {unit}. The loop uses "
                f"{factor * x.used:.3g} {unit}."
            )
        if x.freedom is not None:
            text.append(
                f"The noise of {c} has heavy tails (Student's t-distribution with {x.freedom:.2g} "
                "degrees of freedom), so large errors have a smaller weight in the fit."
            )
    return text


def discrepancy_records(outcome: LoopOutcome) -> dict[str, dict[str, float | None]]:
    """Returns each channel's declared, extrapolated, measured and used discrepancy.

    All values are fractions of the channel's rms. The used value is in the noise of the final fit.
    If the model has only one mesh, the lower limit and the measured value are None.
    """
    search, declared = outcome.search, outcome.problem.declared
    return {
        channel: search.measured[channel]._replace(used=used)._asdict()
        if channel in search.measured
        else {
            "declared": declared.get(channel), "lower_limit": None, "measured": None, "used": used,
        }
        for channel, used in search.discrepancies.items()
    }  # fmt: skip


def discrepancy_sentences(outcome: LoopOutcome) -> list[str]:
    """Returns a sentence if the data contain a repeatable error of the thrust."""
    x = outcome.search.measured.get("thrust")
    if x is None or x.measured is None or x.measured <= REPEATABLE_RATIO * x.lower_limit:
        return []
    error = x.used - x.measured if x.declared is None else 0.0
    if x.measured - REPEATABLE_ERRORS * error <= x.lower_limit:
        return []
    least = "at least " if x.measured >= outcome.problem.all_channels["thrust"].discrepancy else ""
    return [
        f"The data contain a repeatable error of {least}{100.0 * x.measured:.2g} % of the "
        f"thrust's rms that no effect explains. The model's own discretisation error is at most "
        f"about {100.0 * x.lower_limit:.2g} %."
    ]


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
    return toml_text(tables, "\n".join(verdict_sentences(outcome)))
