"""report.html: one file with its pictures inside, for someone who was not there."""

from typing import Any

import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome
from calibration.discrepancy.localise import said
from calibration.discrepancy.rounds import AGREE, UNALIKE
from calibration.inference.goodness import FLOOR
from calibration.model.predict import CHANNELS
from calibration.reporting.html import document, paragraph, picture, table, text
from calibration.reporting.parameters import widened

SHOWN = {"p_front": (1e-3, "kPa"), "p_rear": (1e-3, "kPa"), "thrust": (1e3, "mN"),
         "recoil": (1e3, "mN"), "tip": (1e3, "mm")}  # fmt: skip
SHOWN_STRIDES = 3.0
"""Of a trial's end; seconds where it has no frequency."""


def loop_page(outcome: LoopOutcome, told: dict[str, Any]) -> str:
    """The whole page."""
    parts = [
        paragraph(told["said"], "verdict"),
        paragraph(f"Verdict: {told['verdict']}. " + _made_from(told)),
        "<h2>Error before and after</h2>",
        "<p>Root mean square of measured less predicted. The floor is what noise, tare and the "
        "difference of correct programs leave.</p>",
        _errors("Trials that the search used", told["errors"]),
        _left_over(told["left_over_noise"]),
    ]
    if told["held_out"]:
        names = ", ".join(told["held_out_trials"])
        parts.append(_errors(f"Trials held out of it ({names})", told["held_out"]))
    parts += [
        "<h2>Measured, before and after</h2>",
        picture(readings_figure(outcome), "readings and residuals of one trial"),
        "<h2>Parameters</h2>",
        _parameters(told),
        "<h2>Candidates</h2>",
        "<p>Score: by how much a candidate and the parameters together lower the sum of squares "
        "of the noise-free residual, in units of its mean square, by one linearisation.</p>",
        picture(score_figure(told), "scores of the candidates; the chosen one is blue"),
        _refitted(told),
        _rivals(told["effects"]),
    ]
    if "consequence" in told:
        parts += ["<h2>What it changes for thrust</h2>", _consequence(told["consequence"])]
    parts += ["<h2>Audit of the data</h2>", _audit(told["audit"])]
    if told["unexplained"]:
        parts += ["<h2>What is left</h2>", _left(told["unexplained"])]
    if following := told["next_experiment"]:
        parts += ["<h2>Next experiment</h2>", paragraph(following["said"])]
        if following["toml"]:
            parts.append(f"<pre>{text(following['toml'])}</pre>")
    return document(outcome.experiment.name, parts)


def _errors(title: str, errors: dict[str, dict[str, float]]) -> str:
    rows = []
    for channel, row in errors.items():
        factor, unit = SHOWN[channel]
        rows.append([f"{channel} ({unit})", *(f"{factor * row[x]:.3g}" for x in row)])
    return f"<h3>{text(title)}</h3>" + table(["channel", "before", "after", "floor"], rows)


def _left_over(times: dict[str, float]) -> str:
    """How far from the floor a fit is: an rms can lie above it by the tares of a few trials."""
    above = [c for c, x in times.items() if x**2 > FLOOR]
    said = (
        "Each weighed by how its own noise is correlated, tares and drift included, after leaves "
    )
    said += ", ".join(f"{c} {x:.2f}" for c, x in times.items()) + " times the noise. Up to "
    said += f"{np.sqrt(FLOOR):.2f} is at the floor"
    return paragraph(said + (f"; above it: {', '.join(above)}." if above else "."))


def _parameters(told: dict[str, Any]) -> str:
    found = dict(told["parameters"])
    for effect in told["effects"]:
        found |= {f"{effect['name']}.{n}": x for n, x in effect["parameters"].items()}
    head, before = ["parameter", "value", "95 % interval", "unit", "started from"], ["given"]
    if told["effects"]:
        head, before = [*head, "without the effects"], [*before, "without_effects"]
    rows = [
        [name, *_interval(x), *(f"{x[key]:.4g}" if key in x else "" for key in before)]
        for name, x in found.items()
    ]
    said = [
        paragraph(f"{name}: {widened(x)}.")
        for name, x in found.items()
        if "by_variation_alone" in x
    ]
    return table(head, rows) + "".join(said)


def _interval(x: dict[str, Any]) -> list[str]:
    if x["value"] is None:
        return ["not determined by these data", f"{x['low']:.3g} to {x['high']:.3g}", x["unit"]]
    return [f"{x['value']:.4g}", f"{x['low']:.4g} to {x['high']:.4g}", x["unit"]]


def _made_from(told: dict[str, Any]) -> str:
    of = told["input"]
    files = [of] if "path" in of else of["logs"]
    names = ", ".join(f"{x['path']} (sha256 {x['sha256'][:12]})" for x in files)
    by, held = told["versions"], ", ".join(told["held_out_trials"])
    said = f"From {names}, by slider_jax {by['slider_jax']} with jax {by['jax']} in "
    said += f"{told['seconds']:.0f} s."
    if held:
        said += f" The search did not see {held}; the parameters are refitted to all."
    return said


def _refitted(told: dict[str, Any]) -> str:
    """Of each round the candidates that were refitted, the best first: why one was chosen."""
    rows = sorted(
        (x for x in told["candidates"] if "explained" in x),
        key=lambda x: (x["round"], -x["explained"]),
    )
    if not rows:
        return "<p>None scored beyond chance and so was refitted.</p>"
    said = (
        "<p>Those that scored best were refitted together with all parameters. Chosen is, of those "
        "that change a channel by enough to be worth a name and on which the trials left out agree "
        f"(factor over its standard error above {AGREE:g}, or chance below {UNALIKE:g}), the one "
        "that lowers the sum of squares most.</p>"
    )
    cells = [
        [
            f"{x['round']}: {x['name']}", f"{x['score']:.4g}", f"{x['explained']:.4g}",
            "yes" if x["worth_naming"] else "no",
            f"{x['left_out_trials_agree']:.2g}", f"{x['left_out_trials_chance']:.2g}",
            "chosen" if x["chosen"] else "",
        ]
        for x in rows
    ]  # fmt: skip
    head = ["round: candidate", "score", "refitted", "large enough", "trials agree", "chance", ""]
    return said + table(head, cells)


def _rivals(effects: list[dict[str, Any]]) -> str:
    """By how much every rival fits worse in the place of what was chosen."""
    cells = [
        [
            f"{x['name']} for {effect['name']}", f"{x['loss']:.4g}",
            ", ".join(f"{c} {100.0 * size:.2g} %" for c, size in x["channels"].items()),
            "yes" if x["told_apart"] else "no",
        ]
        for effect in effects
        for x in effect["rivals"]
    ]  # fmt: skip
    if not cells:
        return ""
    said = (
        "<p>Rivals that explained nearly as much, each put in the place of what was chosen, and "
        "everything fitted again: by how much the sum of squares is larger then, and what the two "
        "fits differ by, the first in units of its mean square. One that fits better by enough to "
        "be worth a name takes the place.</p>"
    )
    return said + table(["rival", "fits worse by", "channels differ by", "told apart"], cells)


def _consequence(told: dict[str, Any]) -> str:
    models = {name: x for name, x in told.items() if isinstance(x, dict)}
    said = (
        f"<p>The built-in robot under a {text(told['waveform'])} wave of "
        f"{1e-3 * told['amplitude_Pa']:.0f} kPa at {told['frequency_Hz']:g} Hz, last stride.</p>"
    )
    head = ["pressure model", "mean thrust (mN)", "recoil rms (mN)", "tip (mm)", "pressure (kPa)"]
    rows = [
        [
            name,
            f"{1e3 * x['mean_thrust_N']:.1f}",
            f"{1e3 * x['recoil_rms_N']:.0f}",
            f"{1e3 * x['tip_half_range_m']:.1f}",
            f"{1e-3 * x['pressure_half_range_Pa']:.0f}",
        ]
        for name, x in models.items()
    ]
    return said + table(head, rows)


def _audit(rows: list[dict[str, Any]]) -> str:
    if not rows:
        return "<p>No fault was found in the data.</p>"
    return table(
        ["trial", "what", "channel", "found", "so it was"],
        [[x["trial"], x["kind"], x["channel"] or "", x["detail"], x["action"]] for x in rows],
    )


def _left(rows: list[dict[str, Any]]) -> str:
    return "".join(paragraph(said(x)) for x in rows)


def readings_figure(outcome: LoopOutcome):
    """Readings of the last strides of one trial, and its residuals, of both models."""
    import matplotlib.pyplot as plt

    record, before, after = _shown_trial(outcome)
    channels = [c for c in CHANNELS if record.has(c)]
    figure, axes = plt.subplots(
        len(channels), 2, figsize=(12, 1.2 + 1.6 * len(channels)), sharex="col", squeeze=False,
        layout="constrained",
    )  # fmt: skip
    late = record.t >= record.t[-1] - SHOWN_STRIDES / (record.trial.frequency or 1.0)
    models = ((before, "before", "tab:orange"), (after, "after", "tab:blue"))
    for (left, right), channel in zip(axes, channels, strict=True):
        row, (factor, unit) = CHANNELS.index(channel), SHOWN[channel]
        there = record.there(channel)
        here, t, y = there & late, record.t, factor * record.values[row]
        left.plot(t[here], y[here], ".", color="0.6", ms=2, label="measured")
        for series, label, colour in models:
            left.plot(t[here], factor * series[row][here], color=colour, lw=1.0, label=label)
            apart = (y - factor * series[row])[there]
            right.plot(t[there], apart, color=colour, lw=0.7, label=label)
        left.set_ylabel(f"{channel}\n({unit})")
    axes[0, 0].set_title(f"{record.trial.file}, its end", loc="left", fontsize=10)
    axes[0, 1].set_title("measured less predicted, all of it", loc="left", fontsize=10)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3, fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("time (s)")
    return figure


def _shown_trial(outcome: LoopOutcome):
    """The seen trial on which the fits differ most: its record, and both predictions."""
    seen = [i for i in range(len(outcome.problem.records)) if i not in outcome.held]
    pairs = list(zip(outcome.search.base.predicted, outcome.chosen.predicted, strict=True))
    rows = [CHANNELS.index(c) for c in outcome.problem.channels]
    apart = [
        sum(float(np.mean((a[c] - b[c]) ** 2) / max(np.var(a[c]), 1e-300)) for c in rows)
        for a, b in pairs
    ]
    k = int(np.argmax(apart))
    return outcome.problem.records[seen[k]], *pairs[k]


def score_figure(told: dict[str, Any]):
    """The best scores of every round."""
    import matplotlib.pyplot as plt

    rounds = sorted({x["round"] for x in told["candidates"]})
    figure, axes = plt.subplots(
        1, max(len(rounds), 1), figsize=(max(5.0 * len(rounds), 6.0), 4), layout="constrained",
        squeeze=False,
    )  # fmt: skip
    for axis, number in zip(axes[0], rounds, strict=False):
        rows = [x for x in told["candidates"] if x["round"] == number][:12][::-1]
        colours = ["C0" if x["chosen"] else "0.7" for x in rows]
        axis.barh([x["name"] for x in rows], [max(x["score"], 0.1) for x in rows], color=colours)
        axis.set(xscale="log", xlabel="score (-)", title=f"round {number}")
    return figure
