"""Writes the comparison with the published speeds as report.json and report.html."""

import math
from typing import Any, NamedTuple

import numpy as np

from calibration.discrepancy.verdict import CLASS, IDENTIFIED, INCONCLUSIVE, UNEXPLAINED
from calibration.free_swimming.published_speeds import (
    FIRST,
    OPTIMUM,
    PAPER_MODEL_AT_OPTIMUM,
    RESISTIVE_EFFECTS,
    STEADY_SETTINGS,
    SpeedPrediction,
    UnresistedSwim,
)
from calibration.reporting.html import embedded_png, render_page
from slider_jax.io.figures import new_figure
from slider_jax.io.files import versions

EQUIVALENT_SHARE = 0.8
"""Effects that remove more than this fraction of `unresisted_error` are equivalent effects."""
NEXT_SPEED_EXPERIMENT = (
    "Record the set pressures and the tail's EI in the 5 Hz test. Tow the straight, unpowered "
    "robot at 0.1 to 0.4 m/s, with and without the tubes, to measure the resistance without a "
    "model."
)


class CrossPrediction(NamedTuple):
    """Simulations without axial resistance, and predictions of both published speeds."""

    before: list[UnresistedSwim]
    forward: list[SpeedPrediction]
    """Predictions of the optimum's speed by effects that were calibrated at 5 Hz."""
    backward: list[SpeedPrediction]
    """Predictions of the speed at 5 Hz by effects that were calibrated at the optimum."""


def allowed_error() -> float:
    """Returns the allowed error [m/s] of a prediction: twice the combined error of both points."""
    return 2.0 * math.hypot(FIRST.error, OPTIMUM.error)


def unresisted_error(x: CrossPrediction) -> float:
    """Returns the smallest error [m/s] of the optimum's steady speeds without axial resistance."""
    return min(b.steady for b in x.before if b.point == OPTIMUM.name) - OPTIMUM.speed


def speeds_verdict(x: CrossPrediction) -> tuple[str, SpeedPrediction]:
    """Returns the verdict and the most accurate prediction with a coefficient in its prior range.

    Each prediction assumes values for the quantities that the paper does not give. The verdict is
    "unexplained" if no prediction is within the allowed error. The verdict is "inconclusive" if the
    predictions within this error are fewer than half of all predictions by the best effect.
    """
    in_prior = [a for a in x.forward if a.in_prior] or x.forward
    best = min(in_prior, key=lambda a: abs(a.error))
    removes = {
        n: 1.0 - min(abs(a.error) for a in x.forward if a.resisting == n) / unresisted_error(x)
        for n in RESISTIVE_EFFECTS
    }
    passing = [a for a in x.forward if a.in_prior and abs(a.error) <= allowed_error()]
    if not passing:
        return UNEXPLAINED, best
    if 2 * len(passing) < sum(a.resisting == best.resisting for a in x.forward):
        return INCONCLUSIVE, best
    others = [n for n in RESISTIVE_EFFECTS if n != best.resisting and removes[n] > EQUIVALENT_SHARE]
    return (CLASS if others else IDENTIFIED), best


def speeds_sentence(x: CrossPrediction) -> str:
    """Returns the verdict in sentences."""
    verdict, best = speeds_verdict(x)
    ends, steady = [b.by_stride[-1] for b in x.before], [b.steady for b in x.before]
    sentences = (
        f"In free swimming, the paper's equations reach {min(ends):.2f} to {max(ends):.2f} m/s in "
        f"{len(x.before[0].by_stride)} strides and a steady {min(steady):.1f} to "
        f"{max(steady):.1f} m/s, because nothing resists axial motion."
    )
    predicted = [a.predicted for a in x.forward]
    sentences += (
        f" Calibrated at 5 Hz ({best.gait}; {best.head}), {best.resisting} predicts "
        f"{100 * best.predicted:.1f} cm/s at the optimum (published {100 * OPTIMUM.speed:.1f}, the "
        f"paper's model {100 * PAPER_MODEL_AT_OPTIMUM:.1f} cm/s). With all assumptions about "
        f"quantities that the paper does not give, the predictions are {100 * min(predicted):.1f} "
        f"to {100 * max(predicted):.1f} cm/s."
    )
    if verdict == UNEXPLAINED:
        return sentences + (
            " No coefficient within its prior range gives both speeds within "
            f"{100 * allowed_error():.1f} cm/s, twice their combined error."
        )
    if verdict == INCONCLUSIVE:
        sentences += " The resistance depends on quantities that the paper does not give."
    return sentences + " These points cannot discriminate between axial friction and form drag."


def speeds_record(x: CrossPrediction, seconds: float) -> dict[str, Any]:
    """Returns the content of report.json."""
    verdict, best = speeds_verdict(x)
    alone = verdict in (IDENTIFIED, UNEXPLAINED)
    others = [] if alone else [n for n in RESISTIVE_EFFECTS if n != best.resisting]
    return {
        "verdict": verdict,
        "said": speeds_sentence(x),
        "effects": [
            {
                "name": best.resisting,
                "class": others,
                "parameters": _coefficient_range(x.forward, best),
                "where": "free swimming: mean force along the course",
            }
        ],
        "errors": {
            "speed_at_optimum": {
                "before": unresisted_error(x), "after": abs(best.error), "floor": OPTIMUM.error,
                "unit": "m/s",
            }
        },
        "before": [
            {
                "point": b.point, "gait": b.gait, "head": b.head,
                "speed_after_strides_m_per_s": b.by_stride[[9, 29, -1]],
                "steady_speed_m_per_s": b.steady,
            }
            for b in x.before
        ],
        "after": [vars(a) | {"believed": a.in_prior} for a in [*x.forward, *x.backward]],
        "published": [
            {"name": p.name, "speed_m_per_s": p.speed, "error_m_per_s": p.error,
             "gaits": {n: g._asdict() for n, g in p.gaits.items()}}
            for p in (FIRST, OPTIMUM)
        ],
        "audit": [
            "The paper gives the length of the tail of the 5 Hz test, 60 mm, but not the pressures "
            "and the stiffness of this tail; three alternatives are assumed.",
            "The paper does not give the phase of the largest measured speed at 5 Hz; 0.2 is "
            "assumed, the good phase in its discussion.",
            "The speed at the optimum was measured with a tail of 70 mm. The paper's model has "
            "53 mm.",
        ],
        "next_experiment": NEXT_SPEED_EXPERIMENT,
        "settings": {
            "settling_strides": STEADY_SETTINGS.settling,
            "corrections": STEADY_SETTINGS.corrections,
            "strides_after_correction": STEADY_SETTINGS.following,
            "precision": STEADY_SETTINGS.precision,
            "steps_per_stride": STEADY_SETTINGS.steps_per_stride,
            "nodes": STEADY_SETTINGS.numerics.nodes,
        },
        "seconds": seconds,
        "versions": versions(),
    }  # fmt: skip


def _coefficient_range(
    predictions: list[SpeedPrediction], best: SpeedPrediction
) -> dict[str, dict[str, Any]]:
    """Returns a record of the best coefficient with its range; the key is the parameter's name."""
    values = [a.coefficient for a in predictions if a.resisting == best.resisting]
    ((parameter, prior),) = RESISTIVE_EFFECTS[best.resisting](0.0).priors().items()
    record = {
        "value": best.coefficient, "low": min(values), "high": max(values), "unit": prior.unit,
        "interval": "range with all assumptions about quantities that the paper does not give",
    }  # fmt: skip
    return {parameter: record}


def _rows(predictions: list[SpeedPrediction]) -> list[list[str]]:
    return [
        [
            a.resisting, a.head, a.gait, f"{a.coefficient:.3g}",
            "yes" if a.in_prior else "no", a.predicted_gait, f"{100 * a.predicted:.1f}",
            f"{100 * a.error:+.1f}",
        ]
        for a in predictions
    ]  # fmt: skip


PREDICTION_COLUMNS = ["effect", "head", "calibrated with", "coefficient", "in prior",
                      "predicted with", "cm/s", "error (cm/s)"]  # fmt: skip


def speeds_table(x: CrossPrediction) -> str:
    """Returns the predictions of the optimum as a table for the terminal."""
    lines = [f"{'published':<44}{100 * OPTIMUM.speed:6.1f} cm/s"]
    for a in x.forward:
        lines.append(
            f"{a.resisting} = {a.coefficient:.3g}".ljust(44)
            + f"{100 * a.predicted:6.1f} cm/s  {a.gait}; {a.head}"
        )
    return "\n".join(lines)


def speeds_page(x: CrossPrediction, record: dict[str, Any]) -> str:
    """Returns the content of report.html. `record` is the content of report.json."""
    return render_page(
        "free_swimming.html",
        title="The paper's free-swimming speeds",
        record=record,
        before_png=embedded_png(unresisted_figure(x.before)),
        after_png=embedded_png(prediction_figure(x.forward)),
        head=PREDICTION_COLUMNS,
        forward=_rows(x.forward),
        first_speed=FIRST.speed,
        backward=_rows(x.backward),
    )


def unresisted_figure(found: list[UnresistedSwim]):
    """Draws the mean speed of each stride from rest without axial resistance."""
    figure, axis = new_figure(figsize=(9, 3.8))
    shown = [b for b in found if b.head == found[0].head]
    for b in shown:
        axis.plot(np.arange(1, len(b.by_stride) + 1), b.by_stride, label=f"{b.point}\n{b.gait}")
    for point, colour in ((FIRST, "0.4"), (OPTIMUM, "k")):
        axis.axhline(point.speed, color=colour, ls=":", label=f"published, {point.name}")
    axis.set(xlabel="strides from rest", ylabel="speed (m/s)", ylim=(0.0, None))
    axis.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def prediction_figure(found: list[SpeedPrediction]):
    """Draws the predictions with the published speed and its error."""
    figure, axis = new_figure(figsize=(9, 3.6))
    low, high = (100 * (OPTIMUM.speed + side * OPTIMUM.error) for side in (-1, 1))
    axis.axvspan(low, high, color="0.8", label="published")
    axis.axvline(100 * PAPER_MODEL_AT_OPTIMUM, color="k", ls=":", label="paper's model")
    gaits = list(dict.fromkeys(a.gait for a in found))
    looks = list(dict.fromkeys((a.resisting, a.head) for a in found))
    for (resisting, head), mark in zip(looks, "osD^", strict=False):
        rows = [a for a in found if (a.resisting, a.head) == (resisting, head)]
        places = [gaits.index(a.gait) for a in rows]
        axis.plot([100 * a.predicted for a in rows], places, mark, label=f"{resisting},\n{head}")
    axis.set(xlabel="predicted speed at the optimum (cm/s)", yticks=range(len(gaits)))
    axis.set_yticklabels([g.replace(", ", ",\n").replace(" (", "\n(") for g in gaits])
    axis.margins(y=0.2)
    axis.invert_yaxis()
    axis.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure
