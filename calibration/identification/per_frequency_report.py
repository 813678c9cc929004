"""Writes the comparison of constant and frequency-dependent parameters: JSON, CSV, TOML, figure."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration.experiment_design.parameter_trial import proposal_record
from calibration.identification.identify import entry_lines
from calibration.identification.parameter_ties import CONSTANT, EACH, PAPER, RAMP, RAMP_PARAMETERS
from calibration.identification.per_frequency import (
    FittedTies,
    FrequencyComparison,
    comparison_text,
    tied_values,
)
from calibration.inference.uncertainty import correlations
from calibration.reporting.parameters import model_tables, parameter_record
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.toml import significant, toml_text
from slider_jax.paper import RAMP_END, RAMP_START, force_coefficients


def per_frequency_record(found: FrequencyComparison) -> dict[str, Any]:
    """Returns the comparison in the form that calibration.json contains."""
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
        "ways": {name: _fit_record(x) for name, x in found.fitted.items()},
        "determined_by": {
            found.fitted[EACH].ties.labels[i]: proposal_record(x)
            for i, x in found.proposals.items()
        },
        "definitions": {
            "left_out": "sum of squares of the whitened residuals at each frequency. The trials of "
            "this frequency are simulated with parameters that are fitted to all other frequencies "
            "and, if they depend on frequency, interpolated",
            "chosen": "of the descriptions whose sum of squares on held-out frequencies is within "
            "one standard error of the smallest sum, the description with the fewest parameters",
        },
    }


def _fit_record(fitted: FittedTies) -> dict[str, Any]:
    ties, fit = fitted.ties, fitted.fit
    return {
        "parameters": {
            label: parameter_record(fit, ties.entries, i) for i, label in enumerate(ties.labels)
        },
        "correlations": {"order": ties.labels, "matrix": correlations(fit)},
        "converged": fit.converged,
        "mean_square_over_noise": fit.square / fit.samples,
        "left_out": fitted.left_out,
    }


def frequency_columns(found: FrequencyComparison, each: Sequence[str]) -> dict[str, np.ndarray]:
    """Returns the columns of per_frequency.csv, which has one row for each frequency.

    A value that the data do not determine is NaN, so the CSV file has an empty cell.
    """
    table = {"frequency_Hz": found.frequencies}
    table["trials"] = np.bincount(found.place).astype(float)
    ramp = np.array([[float(x) for x in force_coefficients(float(f))] for f in found.frequencies]).T
    for label in each:
        rows = tied_values(found.fitted[EACH], label)
        table[label] = np.array([v if known else np.nan for v, _, _, known in rows])
        table[f"{label}_low"] = np.array([low for _, low, _, _ in rows])
        table[f"{label}_high"] = np.array([high for _, _, high, _ in rows])
        constant = tied_values(found.fitted[CONSTANT], label)[0][0]
        table[f"{label}_constant"] = np.full(len(rows), constant)
        if label in RAMP_PARAMETERS:
            table[f"{label}_paper"] = ramp[RAMP_PARAMETERS.index(label)]
    return table


def per_frequency_table(found: FrequencyComparison) -> str:
    """Returns the comparison as text: one line for each fitted value, then the result."""
    each = found.fitted[EACH]
    lines = entry_lines(each.fit, each.ties.entries, each.ties.labels, found.proposals)
    return "\n".join([*lines, "", comparison_text(found)])


def per_frequency_model(found: FrequencyComparison, each: Sequence[str]) -> str:
    """Returns the text of a model file with the chosen values, for `slider simulate --model`.

    If C_d and m_a are a ramp with fitted end values, or separate values for each frequency, the
    file contains them as a table. If other parameters depend on frequency, the file contains
    constant values, because a model file has no table for other parameters.
    """
    used = found.used
    entries, theta = used.ties.entries, used.fit.theta
    effects = list(dict.fromkeys(p.effect for p in found.entries if p.effect))
    if used.ties.name == EACH and not set(each) <= set(RAMP_PARAMETERS):
        constant = found.fitted[CONSTANT]
        comment = (
            f"{comparison_text(found)} In a model file, only C_d and m_a can depend on frequency, "
            "so this file contains constant values."
        )
        return toml_text(model_tables(constant.ties.entries, constant.fit.theta, effects), comment)
    if used.ties.name == CONSTANT:
        return toml_text(model_tables(entries, theta, effects), comparison_text(found))
    common = [i for i, p in enumerate(entries) if p.label not in RAMP_PARAMETERS]
    tables = model_tables([entries[i] for i in common], theta[common], effects)
    law: dict[str, Any] = {"force_coefficients": "ramp"}
    if used.ties.name != PAPER:
        rows = [
            {
                "frequency": significant(f),
                "C_d": significant(max(C_d, 0.0)),
                "m_a": significant(max(m_a, 0.0)),
            }
            for f, C_d, m_a in coefficient_table(found)
        ]
        law = {"force_coefficients": "table", "coefficients": rows}
    tables["parameters"] = tables["parameters"] | law
    return toml_text(tables, comparison_text(found))


def coefficient_table(found: FrequencyComparison) -> list[tuple[float, float, float]]:
    """Returns rows (frequency [Hz], C_d, m_a). Between two rows, C_d and m_a are linear."""
    ramp = found.used.ties.name == RAMP
    at = np.array([RAMP_START, RAMP_END]) if ramp else found.frequencies
    rows = []
    for label in RAMP_PARAMETERS:
        values = [v for v, _, _, _ in tied_values(found.used, label)]
        rows.append(values if len(values) == len(at) else values * len(at))
    return list(zip(at.tolist(), *rows, strict=True))


def plot_by_frequency(found: FrequencyComparison, each: Sequence[str], path: Path) -> None:
    """Plots every parameter in `each` and its 95 % interval against drive frequency."""
    figure, axes = new_figure(1, len(each), figsize=(5.2 * len(each), 4.2), squeeze=False)
    f = found.frequencies
    fine = np.linspace(0.9 * f.min(), 1.05 * f.max(), 200)
    for axis, label in zip(axes[0], each, strict=True):
        (value, low, high, _), *_ = tied_values(found.fitted[CONSTANT], label)
        axis.axhspan(low, high, color="tab:blue", alpha=0.15)
        axis.axhline(value, color="tab:blue", label="constant, 95 %")
        if label in RAMP_PARAMETERS:
            paper = [
                float(force_coefficients(float(x))[RAMP_PARAMETERS.index(label)]) for x in fine
            ]
            axis.plot(fine, paper, color="tab:orange", label="paper's ramp")
        if RAMP in found.fitted:
            ends = [v for v, _, _, _ in tied_values(found.fitted[RAMP], label)]
            axis.plot(
                fine, np.interp(fine, [RAMP_START, RAMP_END], ends), "--", color="tab:green",
                label="ramp, ends identified",
            )  # fmt: skip
        rows = np.array([x[:3] for x in tied_values(found.fitted[EACH], label)])
        known = np.array([x[3] for x in tied_values(found.fitted[EACH], label)])
        for here, colour, name in (
            (known, "black", "separate values, 95 %"),
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
