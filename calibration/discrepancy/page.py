"""Writes the loop's report page with tables and figures."""

from typing import Any

import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome
from calibration.discrepancy.localise import residual_text
from calibration.discrepancy.report import (
    choice_sentence,
    discrepancy_sentences,
    effect_sentences,
    instability_sentences,
    noise_sentences,
    pattern_text,
    residual_sentence,
    veto_sentences,
)
from calibration.discrepancy.verdict import BEYOND_PRIOR, CLASS, IDENTIFIED, PROVISIONAL
from calibration.reporting.html import embedded_png, render_page
from calibration.reporting.parameters import undetermined, widened
from slider_jax.channels import ChannelSet
from slider_jax.io.figures import new_figure

SHOWN_STRIDES = 3.0
"""Number of strides in the figure of readings, or of seconds if the trial has no frequency."""
STATUS_TEXTS = {
    IDENTIFIED: "the effect is a missing cause",
    CLASS: "the effect or an equivalent effect is a missing cause",
    BEYOND_PRIOR: "a parameter of the effect is outside its prior range",
    PROVISIONAL: "the effect is a correction: it may be absent or only resemble the cause",
}
"""Meaning of the statuses of added effects."""


def loop_page(
    outcome: LoopOutcome, record: dict[str, Any], learned: dict[str, Any] | None = None
) -> str:
    """Returns the report page (HTML) of a loop. `record` is the content of report.json.

    `learned` contains the picture and the table of errors of a learned function.
    """
    known, settings = dict(record["parameters"]), outcome.search.settings
    channels = outcome.problem.all_channels
    choice = record.get("candidate_choice")
    restricted = choice_sentence(choice) if choice else ""
    for effect in record["effects"]:
        known |= {f"{effect['name']}.{n}": x for n, x in effect["parameters"].items()}
    head, before = ["parameter", "value", "95 % interval", "unit", "started from"], ["given"]
    if record["effects"]:
        head, before = [*head, "without the effects"], [*before, "without_effects"]
    return render_page(
        "loop.html",
        title=outcome.experiment.name,
        record=record,
        learned=learned,
        learned_places=_places(record["learned"]),
        sources=_sources(record["input"]),
        statuses=[
            [
                x["title"],
                x["name"],
                " and ".join(x["segments"]),
                x["status"],
                STATUS_TEXTS[x["status"]],
                ", ".join(x["class"]),
            ]
            for x in record["effects"]
        ],  # fmt: skip
        effect_lines=[
            *effect_sentences(outcome),
            *veto_sentences(outcome),
            *([restricted] if restricted else []),
        ],
        residual_line=residual_sentence(outcome),
        effect_files=_sources({"logs": record["effect_files"]}),
        errors=_errors(channels, record["errors"]),
        held_out=_errors(channels, record["held_out"]),
        floor_ratio=np.sqrt(settings.noise_floor),
        above=[c for c, x in record["left_over_noise"].items() if x**2 > settings.noise_floor],
        patterns=[
            f"{c}: {pattern_text(channels[c], p)}."
            for c, x in outcome.excess.items()
            for p in x.patterns
        ],
        whiteness=_whiteness(record["whiteness"]["channels"]),
        noise=_noise(outcome),
        noise_lines=noise_sentences(outcome),
        discrepancy=_discrepancy(record["discrepancy"]),
        discrepancy_lines=discrepancy_sentences(outcome),
        instability_lines=instability_sentences(outcome),
        readings_png=embedded_png(readings_figure(outcome)),
        scores_png=embedded_png(score_figure(record)),
        parameter_head=head,
        parameters=[
            [name, *_interval(x), *(f"{x[key]:.4g}" if key in x else "" for key in before)]
            for name, x in known.items()
        ],
        widened=[(name, widened(x)) for name, x in known.items() if "by_variation_alone" in x],
        left_out_p=settings.left_out_p,
        wilcoxon_p=settings.wilcoxon_p,
        least_held_gain=settings.least_held_gain,
        least_rest_gain=settings.least_rest_gain,
        most_loss_share=settings.most_loss_share,
        refits=_refits(record["candidates"]),
        alternatives=_alternatives(record["effects"]),
        consequence=_consequence(record["consequence"]) if "consequence" in record else [],
        audit=[
            [x["trial"], x["kind"], x["channel"] or "", x["detail"], x["action"]]
            for x in record["audit"]
        ],
        residuals=[residual_text(x) for x in record["unexplained"]],
    )


def _places(learned: dict[str, Any] | None) -> list[list[str]]:
    """Returns a row for each place at which the dictionary was tested."""
    places = learned["places"] if learned else []
    return [[x["place"], ", ".join(x["terms"]), f"{x['gain']:.4g}"] for x in places]


def _sources(given: dict[str, Any]) -> str:
    files = [given] if "path" in given else given["logs"]
    return ", ".join(f"{x['path']} (sha256 {x['sha256'][:12]})" for x in files)


def _errors(channels: ChannelSet, errors: dict[str, dict[str, float]]) -> list[list[str]]:
    rows = []
    for channel, row in errors.items():
        factor, unit = channels[channel].plot_factor, channels[channel].plot_unit
        rows.append([f"{channel} ({unit})", *(f"{factor * x:.3g}" for x in row.values())])
    return rows


def _whiteness(channels: dict[str, Any]) -> list[list[str]]:
    """Returns a row for every channel with the worst results of both tests of whiteness."""
    return [
        [
            channel, f"{x['correlation']['correlation']:.2g}",
            f"{x['correlation']['correlation_p']:.1g}", x["correlation"]["trial"],
            f"{100.0 * x['line']['line']:.2g} %", f"{x['line']['line_p']:.1g}",
            f"{x['line']['frequency_Hz']:.3g} Hz", x["line"]["trial"],
        ]
        for channel, x in channels.items()
    ]  # fmt: skip


def _noise(outcome: LoopOutcome) -> list[list[str]]:
    """Returns a row for every channel with its declared, measured and used white noise."""
    rows, channels = [], outcome.problem.all_channels
    for channel, x in outcome.noise.items():
        factor, unit = channels[channel].plot_factor, channels[channel].plot_unit
        sizes = ["" if y is None else f"{factor * y:.3g}" for y in (x.declared, x.measured, x.used)]
        tails = "normal" if x.freedom is None else f"{x.freedom:.2g} degrees of freedom"
        rows.append([f"{channel} ({unit})", *sizes, x.method, tails])
    return rows


def _discrepancy(channels: dict[str, dict[str, float | None]]) -> list[list[str]]:
    """Returns a row for every channel with its discrepancies in percent of the channel's rms."""
    return [
        [channel, *("" if y is None else f"{100.0 * y:.2g} %" for y in x.values())]
        for channel, x in channels.items()
    ]


def _interval(x: dict[str, Any]) -> list[str]:
    if x["value"] is None:
        return [undetermined(x), f"{x['low']:.3g} to {x['high']:.3g}", x["unit"]]
    return [f"{x['value']:.4g}", f"{x['low']:.4g} to {x['high']:.4g}", x["unit"]]


def _refits(candidates: list[dict[str, Any]]) -> list[list[str]]:
    """Returns a row for every refitted candidate of each round, best first."""
    rows = [x for x in candidates if "explained" in x]
    return [
        [
            f"{x['round']}: {x['name']}", f"{x['score']:.4g}", f"{x['explained']:.4g}",
            "yes" if x["worth_naming"] else "no",
            f"{x['left_out_trials_t_chance']:.2g}", f"{x['left_out_trials_chance']:.2g}",
            "" if x["left_out_trials_least_gain"] is None
            else f"{x['left_out_trials_least_gain']:.3g}",
            "" if x["left_out_trials_rest_gain"] is None
            else f"{x['left_out_trials_rest_gain']:.3g}",
            "chosen" if x["chosen"] else "",
        ]
        for x in sorted(rows, key=lambda x: (x["round"], -x["explained"]))
    ]  # fmt: skip


def _alternatives(effects: list[dict[str, Any]]) -> list[list[str]]:
    """Returns a row for every alternative substituted for a chosen effect."""
    return [
        [
            f"{x['name']} for {effect['name']}", f"{x['loss']:.4g}",
            ", ".join(f"{c} {100.0 * size:.2g} %" for c, size in x["channels"].items()),
            "yes" if x["told_apart"] else "no",
            ", ".join(f"{n} = {value:.4g}" for n, value in x["parameters"].items()),
        ]
        for effect in effects
        for x in effect["rivals"]
    ]  # fmt: skip


def _consequence(record: dict[str, Any]) -> list[list[str]]:
    return [
        [
            name,
            f"{1e3 * x['mean_thrust_N']:.1f}",
            f"{1e3 * x['recoil_rms_N']:.0f}",
            f"{1e3 * x['tip_half_range_m']:.1f}",
            f"{1e-3 * x['pressure_half_range_Pa']:.0f}",
        ]
        for name, x in record.items()
        if isinstance(x, dict)
    ]


def readings_figure(outcome: LoopOutcome):
    """Plots a trial's last strides and its whole residual, without and with the added effects."""
    record, before, after = _shown_trial(outcome)
    channels = [c for c in record.channels if record.has(c)]
    size = 12.0, 1.2 + 1.6 * len(channels)
    figure, axes = new_figure(len(channels), 2, figsize=size, sharex="col", squeeze=False)
    late = record.t >= record.t[-1] - SHOWN_STRIDES / (record.trial.frequency or 1.0)
    models = ((before, "before", "tab:orange"), (after, "after", "tab:blue"))
    for (left, right), channel in zip(axes, channels, strict=True):
        row, shown = record.row(channel), record.channels[channel]
        factor, unit = shown.plot_factor, shown.plot_unit
        there = record.there(channel)
        here, t, y = there & late, record.t, factor * record.values[row]
        left.plot(t[here], y[here], ".", color="0.6", ms=2, label="measured")
        for series, label, colour in models:
            left.plot(t[here], factor * series[row][here], color=colour, lw=1.0, label=label)
            difference = (y - factor * series[row])[there]
            right.plot(t[there], difference, color=colour, lw=0.7, label=label)
        left.set_ylabel(f"{channel}\n({unit})")
    axes[0, 0].set_title(f"end of {record.trial.file}", loc="left", fontsize=10)
    axes[0, 1].set_title("measured minus predicted, whole trial", loc="left", fontsize=10)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3, fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("time (s)")
    return figure


def _shown_trial(outcome: LoopOutcome):
    """Returns the trial that the added effects change most, and its predictions (before, after)."""
    fitted = outcome.used_trials
    pairs = list(zip(outcome.search.base.predicted, outcome.chosen.predicted, strict=True))
    rows = outcome.problem.all_channels.rows(outcome.problem.channels)
    difference = [
        sum(float(np.mean((a[c] - b[c]) ** 2) / max(np.var(a[c]), 1e-300)) for c in rows)
        for a, b in pairs
    ]
    k = int(np.argmax(difference))
    return outcome.problem.records[fitted[k]], *pairs[k]


def score_figure(record: dict[str, Any]):
    """Plots the best 12 scores of every round."""
    rounds = sorted({x["round"] for x in record["candidates"]})
    size = max(5.0 * len(rounds), 6.0), 4.0
    figure, axes = new_figure(1, max(len(rounds), 1), figsize=size, squeeze=False)
    for axis, number in zip(axes[0], rounds, strict=False):
        rows = [x for x in record["candidates"] if x["round"] == number][:12][::-1]
        colours = ["C0" if x["chosen"] else "0.7" for x in rows]
        axis.barh([x["name"] for x in rows], [max(x["score"], 0.1) for x in rows], color=colours)
        axis.set(xscale="log", xlabel="score (-)", title=f"round {number}")
    return figure
