"""The comparison of constant values, the paper's ramp and values by frequency: files and words."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration.experiment_design.parameter_trial import proposal_record, proposal_sentence
from calibration.identification.parameter_ties import CONSTANT, EACH, FOLLOWS, PAPER, RAMP
from calibration.identification.per_frequency import ByFrequency, Way, comparison_text, values
from calibration.inference.uncertainty import correlations
from calibration.reporting.parameters import model_tables, parameter_record, parameter_text
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.toml import significant, toml_text
from slider_jax.paper import RAMP_END, RAMP_START, force_coefficients


def per_frequency_record(found: ByFrequency) -> dict[str, Any]:
    """What calibration.json says of it."""
    return {
        "said": comparison_text(found),
        "chosen": found.chosen,
        "frequencies_Hz": found.frequencies,
        "trials": [
            [
                r.trial.file
                for r, p in zip(found.problem.records, found.place, strict=True)
                if p == g
            ]
            for g in range(len(found.frequencies))
        ],
        "ways": {name: _way(way) for name, way in found.ways.items()},
        "determined_by": {
            found.ways[EACH].layout.labels[i]: proposal_record(x) for i, x in found.advice.items()
        },
        "definitions": {
            "left_out": "sum of squares of the white residuals of every frequency's trials, "
            "simulated with parameters that were fitted to the other frequencies; values by "
            "frequency are interpolated there",
            "chosen": "fewest parameters within one standard error of the least left-out square",
        },
    }


def _way(way: Way) -> dict[str, Any]:
    entries = way.layout.entries
    return {
        "parameters": {
            label: parameter_record(way.fit, entries, i)
            for i, label in enumerate(way.layout.labels)
        },
        "correlations": {"order": way.layout.labels, "matrix": correlations(way.fit)},
        "converged": way.fit.converged,
        "mean_square_over_noise": way.fit.square / way.fit.samples,
        "left_out": way.left_out,
    }


def frequency_columns(found: ByFrequency, each: Sequence[str]) -> dict[str, np.ndarray]:
    """per_frequency.csv: a row a frequency; a blank value is not determined by these data."""
    table = {"frequency_Hz": found.frequencies}
    table["trials"] = np.bincount(found.place).astype(float)
    ramp = np.array([[float(x) for x in force_coefficients(float(f))] for f in found.frequencies]).T
    for label in each:
        rows = values(found.ways[EACH], label)
        table[label] = np.array([v if known else np.nan for v, _, _, known in rows])
        table[f"{label}_low"] = np.array([low for _, low, _, _ in rows])
        table[f"{label}_high"] = np.array([high for _, _, high, _ in rows])
        table[f"{label}_constant"] = np.full(len(rows), values(found.ways[CONSTANT], label)[0][0])
        if label in FOLLOWS:
            table[f"{label}_paper"] = ramp[FOLLOWS.index(label)]
    return table


def per_frequency_table(found: ByFrequency) -> str:
    """The comparison in words: a line an entry of the values by frequency, then what is best."""
    way, lines = found.ways[EACH], []
    for i, (p, label) in enumerate(zip(way.layout.entries, way.layout.labels, strict=True)):
        lines.append(
            f"{label:<28} {parameter_text(parameter_record(way.fit, way.layout.entries, i))}"
        )
        if i in found.advice:
            lines.append(f"{'':<28} {proposal_sentence(p, found.advice[i])}")
    return "\n".join([*lines, "", comparison_text(found)])


def per_frequency_model(found: ByFrequency, each: Sequence[str]) -> str:
    """The model that explains the data best, for `slider simulate --model`.

    A ramp with other values at its ends, and values by frequency, become a table of C_d and m_a.
    What else differs by frequency has no place in a model file: then constant values are written.
    """
    way = found.used
    entries, theta = way.layout.entries, way.fit.theta
    effects = list(dict.fromkeys(p.effect for p in found.entries if p.effect))
    if way.layout.name == EACH and not set(each) <= set(FOLLOWS):
        constant = found.ways[CONSTANT]
        said = comparison_text(found) + " A model file has no place for these: constant values."
        return toml_text(model_tables(constant.layout.entries, constant.fit.theta, effects), said)
    if way.layout.name == CONSTANT:
        return toml_text(model_tables(entries, theta, effects), comparison_text(found))
    common = [i for i, p in enumerate(entries) if p.label not in FOLLOWS]
    tables = model_tables([entries[i] for i in common], theta[common], effects)
    law: dict[str, Any] = {"force_coefficients": "ramp"}
    if way.layout.name != PAPER:
        rows = [
            {
                "frequency": significant(f),
                "C_d": significant(max(C_d, 0.0)),
                "m_a": significant(max(m_a, 0.0)),
            }
            for f, C_d, m_a in coefficients(found)
        ]
        law = {"force_coefficients": "table", "coefficients": rows}
    tables["parameters"] = tables["parameters"] | law
    return toml_text(tables, comparison_text(found))


def coefficients(found: ByFrequency) -> list[tuple[float, float, float]]:
    """(frequency, C_d, m_a) between which the used way is linear."""
    way = found.used
    if way.layout.name == RAMP:
        at = np.array([RAMP_START, RAMP_END])
    else:
        at = found.frequencies
    rows = []
    for label in FOLLOWS:
        found_values = [v for v, _, _, _ in values(way, label)]
        rows.append(found_values if len(found_values) == len(at) else found_values * len(at))
    return list(zip(at.tolist(), *rows, strict=True))


def picture(found: ByFrequency, each: Sequence[str], path: Path) -> None:
    """Every parameter against drive frequency: values with intervals, constant, and the ramps."""
    figure, axes = new_figure(1, len(each), figsize=(5.2 * len(each), 4.2), squeeze=False)
    f = found.frequencies
    fine = np.linspace(0.9 * f.min(), 1.05 * f.max(), 200)
    for axis, label in zip(axes[0], each, strict=True):
        (value, low, high, _), *_ = values(found.ways[CONSTANT], label)
        axis.axhspan(low, high, color="tab:blue", alpha=0.15)
        axis.axhline(value, color="tab:blue", label="constant, 95 %")
        if label in FOLLOWS:
            paper = [float(force_coefficients(float(x))[FOLLOWS.index(label)]) for x in fine]
            axis.plot(fine, paper, color="tab:orange", label="paper's ramp")
        if RAMP in found.ways:
            ends = [v for v, _, _, _ in values(found.ways[RAMP], label)]
            axis.plot(
                fine, np.interp(fine, [RAMP_START, RAMP_END], ends), "--", color="tab:green",
                label="ramp, ends identified",
            )  # fmt: skip
        rows = np.array([x[:3] for x in values(found.ways[EACH], label)])
        known = np.array([x[3] for x in values(found.ways[EACH], label)])
        for here, colour, name in (
            (known, "black", "by frequency, 95 %"),
            (~known, "0.7", "not determined"),
        ):
            if here.any():
                v, low, high = rows[here].T
                axis.errorbar(
                    f[here], v, [v - low, high - v], fmt="o", color=colour, capsize=3, label=name
                )
        sure = rows[known] if known.any() else rows
        span = max(float(np.ptp(sure)), 0.1 * abs(float(sure.mean())), 1e-12)
        axis.set_ylim(float(sure.min()) - 0.4 * span, float(sure.max()) + 0.6 * span)
        unit = next(p.prior.unit for p in found.entries if p.label == label)
        axis.set_xlabel("drive frequency (Hz)")
        axis.set_ylabel(label if unit == "-" else f"{label} ({unit})")
        axis.grid(alpha=0.25)
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    save_figure(figure, path)
