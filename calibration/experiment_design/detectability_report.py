"""The matrix of effects as a table, as matrix.json and as a picture."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import leaves_list, linkage
from scipy.spatial.distance import squareform

from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.experiment_design.detectability import Limit, Matrix, required_gain
from calibration.experiment_design.information import FINITE_START
from calibration.model.extended import candidates
from slider_jax.channels import CHANNELS
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.files import versions

NOTES = {
    "limit": "distance from the null from which on nine of ten such experiments would find the "
    "effect: beyond chance beside C_d, m_a, k and K_Q, and a change of some channel by more than "
    "two correct programs differ by; half would from significant_from and worth_naming_from on. "
    "To be named, two trials or more must see it",
    "share_of_range": "share of the prior range that lies beyond the limit",
    "limit_over_range": "limit over the distance from the null to the far end of the prior range",
    "alike": "|cos| of what two effects leave once C_d, m_a, k and K_Q are projected out",
    "finite_start": f"judged by a step of {FINITE_START:g} of the prior range, as the tangent at "
    "the null says little of it",
    "told_by_sign": "opposite changes of two parameters that cannot change sign",
}


def detectability_record(m: Matrix, source: dict[str, Any]) -> dict[str, Any]:
    """The content of matrix.json; `source` names the input."""
    experiment, sensing = m.information.experiment, m.information.sensing
    signs = np.argwhere(
        np.triu(m.opposed) & (np.nan_to_num(m.alike) > DEFAULT_SETTINGS.parallel_cosine)
    )
    return {
        "name": experiment.name,
        "limits": [_row(x) for x in m.limits],
        "classes": m.classes,
        "told_by_sign": [[m.names[i], m.names[j]] for i, j in signs],
        "names": m.names,
        "alike": m.alike,
        "channels": {c: noise._asdict() for c, noise in sensing.noise.items()},
        "thresholds": {
            "least_gain": DEFAULT_SETTINGS.min_gain,
            "chance": DEFAULT_SETTINGS.false_alarm_p,
            "candidates": len(candidates()),
            "gain_of_one_parameter": required_gain(1, len(candidates())),
            "alike": DEFAULT_SETTINGS.parallel_cosine,
            "gain_of_a_trial": {name: x.gain for name, x in CHANNELS.items()},
            "discrepancy": {name: x.discrepancy for name, x in CHANNELS.items()},
        },
        "definitions": NOTES,
        "resolution": vars(m.information.coarse),
        "input": source,
        "versions": versions(),
        "settings": experiment.model_dump(),
    }


def _row(x: Limit) -> dict[str, Any]:
    p = x.parameter
    return {
        "effect": p.effect,
        "parameter": p.name,
        "unit": p.prior.unit,
        "limit": x.size,
        "significant_from": x.significant,
        "worth_naming_from": x.nameable,
        "standard_error": x.error,
        "null": p.prior.null,
        "low": p.prior.low,
        "high": p.prior.high,
        "share_of_range": x.share,
        "limit_over_range": x.relative,
        "finite_start": x.finite,
    }


def matrix_table(m: Matrix) -> str:
    """Limits, classes, and the channels that were counted, as text."""
    rows = [("effect", "parameter", "found from", "range that shows", "")]
    for x in m.limits:
        unit = "" if x.parameter.prior.unit == "-" else f" {x.parameter.prior.unit}"
        size = f"{x.size:.2g}{unit}" if np.isfinite(x.size) else "-"
        rows.append((x.parameter.effect, x.parameter.name, size, _shows(x), "*" * x.finite))
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    lines = ["  ".join(f"{x:<{w}}" for x, w in zip(row, widths, strict=True)).rstrip()
             for row in rows]  # fmt: skip
    if any(x.finite for x in m.limits):
        lines.append(f"* judged at {FINITE_START:.0%} of its range: its tangent says too little")
    lines.append("")
    if m.classes:
        lines.append(
            "cannot be told apart by this experiment "
            f"(|cos| > {DEFAULT_SETTINGS.parallel_cosine:g}):"
        )
        lines += [f"  {', '.join(group)}" for group in m.classes]
    else:
        lines.append("every effect that it detects it can tell from the others")
    signs = np.argwhere(
        np.triu(m.opposed) & (np.nan_to_num(m.alike) > DEFAULT_SETTINGS.parallel_cosine)
    )
    lines += [f"  told apart by the sign alone: {m.names[i]}, {m.names[j]}" for i, j in signs]
    lines.append(f"counted: {', '.join(m.information.sensing.noise)}")
    return "\n".join(lines)


def _shows(x: Limit) -> str:
    if np.isnan(x.size):
        return "cannot be simulated"
    return f"detectable in {x.share:.0%} of it" if x.share > 0.0 else "not detectable"


def order(m: Matrix) -> list[int]:
    """Places of the effects such that those alike stand together."""
    if len(m.names) < 3:
        return list(range(len(m.names)))
    apart = 1.0 - np.nan_to_num(m.alike)
    np.fill_diagonal(apart, 0.0)
    return [int(i) for i in leaves_list(linkage(squareform(apart, checks=False), "average"))]


def plot_matrix(m: Matrix, path: Path) -> None:
    """Heat map of |cos|, effects alike beside each other, and the size from which each is found."""
    places = order(m)
    names, n = [m.names[i] for i in places], len(places)
    side = max(5.0, 0.21 * n + 2.5)
    figure, (left, right) = new_figure(
        1, 2, figsize=(side + 4.0, side), width_ratios=[side, 2.2], sharey=True
    )
    shown = np.ma.masked_invalid(m.alike[np.ix_(places, places)])
    image = left.imshow(shown, vmin=0.0, vmax=1.0, cmap="magma_r", aspect="auto")
    left.set_facecolor("0.85")
    for group in m.classes:
        for i in (names.index(x) for x in group):
            for j in (names.index(x) for x in group):
                if i != j:
                    left.plot(i, j, ".", color="white", ms=3)
    left.set_xticks(range(n), names, rotation=90, fontsize=7)
    left.set_yticks(range(n), names, fontsize=7)
    left.set_title(f"{m.information.experiment.name}: how alike two effects look", loc="left")
    bar = figure.colorbar(image, ax=left, location="bottom", shrink=0.5, pad=0.01)
    bar.set_label(
        "|cos| once C_d, m_a, k and K_Q are projected out (-); dots: cannot be told apart",
        fontsize=8,
    )
    _draw_limits(right, [min(x.relative for x in m.limit[name]) for name in names])
    save_figure(figure, path)


def _draw_limits(axes, shares: list[float]) -> None:
    """Detection limits as shares of the prior range, a bar an effect; smaller is better."""
    for row, share in enumerate(shares):
        if share < 1.0:
            axes.barh(row, 100.0 * share, color="tab:blue", height=0.7)
        else:
            axes.text(1.1e-1, row, "not detectable", fontsize=6, va="center")
    axes.set(xscale="log", xlim=(0.1, 100.0), xlabel="of the prior range (%)")
    axes.set_title("found from", loc="left", fontsize=10)
    axes.tick_params(labelleft=False)
    axes.grid(axis="x", color="0.9", lw=0.6)
    axes.set_axisbelow(True)
