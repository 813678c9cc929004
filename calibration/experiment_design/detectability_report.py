"""Writes the detectability matrix as text, as matrix.json and as a figure."""

from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import leaves_list, linkage
from scipy.spatial.distance import squareform

from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.experiment_design.detectability import (
    DetectabilityMatrix,
    DetectionLimit,
    required_gain,
)
from calibration.experiment_design.information import FINITE_START
from calibration.model.extended import candidate_effects
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.files import provenance

NOTES = {
    "limit": "distance from the null at which nine of ten experiments detect the effect. Detection "
    "requires a significant gain after C_d, m_a, k and K_Q are refitted, and a change of a channel "
    "that exceeds the model-discretisation discrepancy. Half of the experiments detect the effect "
    "at the larger of significant_from and worth_naming_from. At least two trials must detect it",
    "share_of_range": "fraction of the prior range in which the effect is detectable",
    "limit_over_range": "limit divided by the distance from the null to the prior range's far end",
    "alike": "|cos| between the tangents of two effects after projecting out C_d, m_a, k and K_Q",
    "finite_start": "true if the limit is computed from a secant, because the effect is nonlinear "
    f"at the null. The secant ends at the declared start, or at {FINITE_START:g} of the range",
    "told_by_sign": "pairs of effects with parallel tangents. Their parameters have one sign each, "
    "with which the two effects change the readings in opposite directions",
}


def detectability_record(m: DetectabilityMatrix, source: dict[str, Any]) -> dict[str, Any]:
    """Returns the content of matrix.json; `source` describes the input file."""
    experiment, sensing = m.information.experiment, m.information.sensing
    return {
        "name": experiment.name,
        "limits": [_row(x) for x in m.limits],
        "classes": m.classes,
        "told_by_sign": _opposed_pairs(m),
        "names": m.names,
        "alike": m.cosines,
        "channels": {c: noise._asdict() for c, noise in sensing.noise.items()},
        "thresholds": {
            "least_gain": DEFAULT_SETTINGS.min_gain,
            "chance": DEFAULT_SETTINGS.false_alarm_p,
            "candidates": len(candidate_effects()),
            "gain_of_one_parameter": required_gain(1, len(candidate_effects())),
            "alike": DEFAULT_SETTINGS.parallel_cosine,
            "gain_of_a_trial": {c: noise.gain for c, noise in sensing.noise.items()},
            "discrepancy": sensing.discrepancies,
        },
        "definitions": NOTES,
        "resolution": vars(m.information.coarse),
        "input": source,
        **provenance(),
        "settings": experiment.model_dump(),
    }


def _opposed_pairs(m: DetectabilityMatrix) -> list[list[str]]:
    parallel = np.nan_to_num(m.cosines) > DEFAULT_SETTINGS.parallel_cosine
    return [[m.names[i], m.names[j]] for i, j in np.argwhere(np.triu(m.opposed) & parallel)]


def _row(x: DetectionLimit) -> dict[str, Any]:
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


def matrix_table(m: DetectabilityMatrix) -> str:
    """Returns the detection limits, the equivalence classes and the used channels as text."""
    rows = [("effect", "parameter", "limit", "prior range", "")]
    for x in m.limits:
        unit = "" if x.parameter.prior.unit == "-" else f" {x.parameter.prior.unit}"
        size = f"{x.size:.2g}{unit}" if np.isfinite(x.size) else "-"
        share = f"{x.share:.0%} detectable" if x.share > 0.0 else "not detectable"
        share = "cannot be simulated" if np.isnan(x.size) else share
        rows.append((x.parameter.effect, x.parameter.name, size, share, "*" * x.finite))
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    lines = ["  ".join(f"{x:<{w}}" for x, w in zip(row, widths, strict=True)).rstrip()
             for row in rows]  # fmt: skip
    if any(x.finite for x in m.limits):
        lines.append(
            f"* computed with a step of {FINITE_START:.0%} of the prior range (nonlinear effect)"
        )
    lines.append("")
    if m.classes:
        limit = DEFAULT_SETTINGS.parallel_cosine
        lines.append(
            f"This experiment cannot discriminate between these effects (|cos| > {limit:g}):"
        )
        lines += [f"  {', '.join(group)}" for group in m.classes]
    else:
        lines.append("This experiment can discriminate between all effects that it detects.")
    lines += [f"  discriminated by the sign only: {a}, {b}" for a, b in _opposed_pairs(m)]
    lines.append(f"channels: {', '.join(m.information.sensing.noise)}")
    return "\n".join(lines)


def _clustered(m: DetectabilityMatrix) -> list[int]:
    """Returns the indices of the effects, sorted so that parallel effects are neighbours."""
    if len(m.names) < 3:
        return list(range(len(m.names)))
    distance = 1.0 - np.nan_to_num(m.cosines)
    np.fill_diagonal(distance, 0.0)
    return [int(i) for i in leaves_list(linkage(squareform(distance, checks=False), "average"))]


def plot_matrix(m: DetectabilityMatrix, path: Path) -> None:
    """Plots |cos| of all pairs as a heat map, and the detection limits as bars."""
    places = _clustered(m)
    names, n = [m.names[i] for i in places], len(places)
    side = max(5.0, 0.21 * n + 2.5)
    figure, (left, right) = new_figure(
        1, 2, figsize=(side + 4.0, side), width_ratios=[side, 2.2], sharey=True
    )
    shown = np.ma.masked_invalid(m.cosines[np.ix_(places, places)])
    image = left.imshow(shown, vmin=0.0, vmax=1.0, cmap="magma_r", aspect="auto")
    left.set_facecolor("0.85")
    for group in m.classes:
        for first, second in permutations(group, 2):
            left.plot(names.index(first), names.index(second), ".", color="white", ms=3)
    left.set_xticks(range(n), names, rotation=90, fontsize=7)
    left.set_yticks(range(n), names, fontsize=7)
    left.set_title(f"{m.information.experiment.name}: similarity of effects", loc="left")
    bar = figure.colorbar(image, ax=left, location="bottom", shrink=0.5, pad=0.01)
    bar.set_label(
        "|cos| after projecting out C_d, m_a, k and K_Q (-); dots: not discriminated", fontsize=8
    )
    for row, name in enumerate(names):
        share = min(x.relative for x in m.limit[name])
        if share < 1.0:
            right.barh(row, 100.0 * share, color="tab:blue", height=0.7)
        else:
            right.text(1.1e-1, row, "not detectable", fontsize=6, va="center")
    right.set(xscale="log", xlim=(0.1, 100.0), xlabel="limit (% of the prior range)")
    right.set_title("detection limit", loc="left", fontsize=10)
    right.tick_params(labelleft=False)
    right.grid(axis="x", color="0.9", lw=0.6)
    right.set_axisbelow(True)
    save_figure(figure, path)
