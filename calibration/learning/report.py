"""Writes the learned function: a key of report.json, sentences, a figure and a model file."""

from collections.abc import Callable
from typing import Any

from calibration.discrepancy.close_loop import LoopOutcome
from calibration.discrepancy.report import verdict_sentences
from calibration.discrepancy.verdict import LEARNED, PARTLY
from calibration.experiment_design.discriminate import model_distance
from calibration.experiment_design.information import (
    ChannelInformation,
    SensorModel,
    TrialInformation,
)
from calibration.experiment_design.next_experiment import LOOP_EFFORT
from calibration.experiment_design.trial_search import (
    SearchEffort,
    TrialSearch,
    limits_of,
    next_trial_record,
    trial_text,
)
from calibration.inference.goodness import excess_removed
from calibration.learning.curves import curve_record, learned_curves
from calibration.learning.learn import Learning
from calibration.reporting.html import embedded_png
from calibration.reporting.parameters import model_tables, parameter_record
from slider_jax.channels import ChannelSet
from slider_jax.effects.library import KNOWN_EFFECTS
from slider_jax.errors import InputError, SolverError
from slider_jax.io.figures import new_figure
from slider_jax.io.toml import toml_text

Progress = Callable[[str], None]


def learned_record(
    learning: Learning, progress: Progress = lambda text: None, effort: SearchEffort = LOOP_EFFORT
) -> dict[str, Any]:
    """Returns the value of the key `learned` in report.json."""
    records, learned = learning.outcome.problem.records, learning.model
    found: dict[str, Any] = {
        "status": LEARNED if learned else None,
        "reason": learning.reason,
        "trials": [records[i].trial.file for i in learning.outcome.used_trials],
        "places": [
            {"place": x.place, "terms": x.groups, "gain": x.gain, "surplus": x.surplus}
            for x in learning.places
        ],
        "refused": learning.refused,
        "dropped": {name: x._asdict() for name, x in learning.dropped.items()},
    }
    if learned is None:
        return found | {"said": f"No function was learned: {learning.reason}."}
    entries = learned.dictionary.entries
    found |= {
        "said": learned_text(learning),
        "place": learning.places[0].place,
        "equivalent_places": learning.equal_places,
        "replaced_effects": learned.dictionary.replaced,
        "converged": learned.fit.converged,
        "terms": [
            {
                "name": name,
                "title": KNOWN_EFFECTS[name].title,
                "parameters": {
                    p.name: parameter_record(learned.fit, entries, i)
                    for i, p in enumerate(entries)
                    if p.effect == name
                },
                **(learned.stability[name]._asdict() if name in learned.stability else {}),
            }
            for name in (*learned.terms, *learned.fine_parts)
        ],
        "curves": [curve_record(x) for x in learned_curves(learning)],
        "errors": {
            c: {**x, "excess_removed": excess_removed({c: x})} for c, x in learned.errors.items()
        },
        "tested_trials": [records[i].trial.file for i in learned.tested],
        "changes": learned.sizes,
        "above_floor": learned.above_floor,
    }
    progress("searching the trial that tests the learned function")
    return found | {"test": testing_trial(learning, effort, progress)}


def with_learned(record: dict[str, Any], learned: dict[str, Any] | None) -> dict[str, Any]:
    """Returns the content of report.json with the key `learned`.

    If the residual with the learned function is at the noise floor, the verdict becomes `learned`,
    and the next experiment is the trial that tests the function. Otherwise, the function explains a
    part of the residual.
    """
    if learned is None:
        return record
    record = record | {"learned": learned, "said": f"{record['said']} {learned['said']}"}
    if learned["status"] is None:
        return record
    if learned["above_floor"]:
        return record | {"verdict": PARTLY}
    return record | {"verdict": LEARNED, "next_experiment": learned["test"]}


def learned_parts(record: dict[str, Any], channels: ChannelSet) -> dict[str, Any]:
    """Returns the picture and the table of errors for the report page."""
    errors = learned_errors(record, channels)
    return {"png": embedded_png(learned_figure(record)), "errors": errors}


def learned_text(learning: Learning) -> str:
    """Returns the result as sentences."""
    learned = learning.model
    if learned is None:
        return f"No function was learned: {learning.reason}."
    titles = ", ".join(
        f"{KNOWN_EFFECTS[n].title} ({n})" for n in (*learned.terms, *learned.fine_parts)
    )
    text = f"At the place {learning.places[0].place}, the model learned: {titles}."
    text += " A learned function describes the residual; it is not an identified cause."
    replaced = learned.dictionary.replaced
    if replaced:
        text += f" model.toml does not contain {', '.join(replaced)}: the function replaces "
        text += "this effect." if len(replaced) == 1 else "these effects."
    if not learned.fit.converged:
        text += " The fit of the function did not converge."
    if learning.equal_places:
        text += f" Terms of {', '.join(learning.equal_places)} explain the residual equally well."
    above = learned.above_floor
    if above:
        return text + f" The residual of {', '.join(above)} is not only noise."
    return text + " With this function, the residual is at the noise floor."


def testing_trial(
    learning: Learning, effort: SearchEffort = LOOP_EFFORT, progress: Progress = lambda text: None
) -> dict[str, Any]:
    """Returns the record of the trial in which the learned function changes the readings most.

    The change is stated in standard deviations of the noise. The part of the change that the other
    parameters can absorb does not count.
    """
    learned = learning.model
    assert learned is not None
    known, outcome = learned.dictionary, learning.outcome
    problem = known.problem
    noise = {(problem.records[i].trial.file, c): x for (i, c), x in problem.noise.items()}
    prediction = TrialInformation(
        outcome.experiment,
        known.names,
        known.start.theta,
        known.start.free,
        SensorModel.of(outcome.experiment, problem.records, noise),
        {},
        problem.mesh,
        problem.memo,
        learned.fit.theta,
    )

    def distance(channels: list[list[ChannelInformation]]) -> float:
        return model_distance(channels[0], learned.fit.inflation, problem.discrepancies).sigmas

    try:
        search = TrialSearch([prediction], distance, limits_of(outcome.experiment))
        best = search.run(effort, progress)
    except (InputError, SolverError) as error:
        return {
            "purpose": None,
            "said": f"No trial is proposed: {error}",
            "trial": None,
            "toml": "",
        }
    text = (
        f"{trial_text(best.trial)} tests the learned function best: the function changes the "
        f"readings by {best.value:.1f} standard deviations of the noise."
    )
    return next_trial_record("test_learned", text, best.trial, search.limits)


def learned_model_toml(outcome: LoopOutcome, learning: Learning) -> str:
    """Returns the model with the learned function, for `slider simulate --model`."""
    learned = learning.model
    assert learned is not None
    entries = learned.dictionary.entries
    names = [*learned.dictionary.effects, *learned.terms, *learned.fine_parts]
    kept = [i for i, p in enumerate(entries) if p.effect in names or i in learned.fit.free]
    tables = model_tables([entries[i] for i in kept], learned.fit.theta[kept], names)
    return toml_text(tables, "\n".join([*verdict_sentences(outcome), learned_text(learning)]))


def learned_figure(record: dict[str, Any]):
    """Plots every learned function with its 95 % band. `record` is the key `learned`."""
    curves = record["curves"]
    size = 4.5 * len(curves), 3.5
    figure, axes = new_figure(1, len(curves), figsize=size, squeeze=False)
    for axis, x in zip(axes[0], curves, strict=True):
        axis.fill_between(x["state"], x["low"], x["high"], color="0.85", label="95 % band")
        axis.plot(x["state"], x["value"], color="tab:blue", label="learned function")
        axis.axhline(0.0, color="0.5", lw=0.7)
        title = x["term"] + (f", {x['part']}" if x["part"] else "")
        axis.set_title(title, loc="left", fontsize=10)
        axis.set_xlabel(f"{x['state_name']} ({x['state_unit']})")
        axis.set_ylabel(f"{x['value_name']} ({x['value_unit']})")
    axes[0, 0].legend(fontsize=9)
    return figure


def learned_lines(record: dict[str, Any]) -> list[str]:
    """Returns a line for each channel's error without and with the function, in the tested trials.

    `record` is the content of report.json. `before` is the error without the function and without
    the replaced effects. The other printed errors and parameters belong to the loop's model, which
    has all added effects and no function.
    """
    learned = record["learned"] or {}
    return [
        f"{c}, with the learned function: rms {x['before']:.3g} without, {x['after']:.3g} with, "
        f"noise floor {x['floor']:.3g} {record['units'][c]}"
        for c, x in learned.get("errors", {}).items()
    ]


def learned_errors(record: dict[str, Any], channels: ChannelSet) -> list[list[str]]:
    """Returns a row for each channel with the errors without and with the function."""
    rows = []
    for channel, x in record["errors"].items():
        factor, unit = channels[channel].plot_factor, channels[channel].plot_unit
        sizes = [f"{factor * x[key]:.3g}" for key in ("before", "after", "floor")]
        removed = x["excess_removed"]
        share = "" if removed is None else f"{100.0 * removed:.0f} %"
        rows.append([f"{channel} ({unit})", *sizes, share])
    return rows
