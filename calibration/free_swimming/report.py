"""The published speeds before and after an effect that resists, as report.json and report.html."""

import math
from typing import Any, NamedTuple

import numpy as np

from calibration.discrepancy.verdict import CLASS, IDENTIFIED, INCONCLUSIVE, UNEXPLAINED
from calibration.free_swimming.published_speeds import (
    FIRST,
    OPTIMUM,
    PAPER_MODEL_AT_OPTIMUM,
    PLAN,
    RESISTING,
    After,
    Before,
)
from calibration.reporting.html import embedded_png, render_page
from slider_jax.io.files import versions

AS_WELL = 0.8
"""Share of the miss from which on another resistance removes it as well."""
NEXT = (
    "The set pressures and the tail of the 5 Hz test. Towing the unpowered robot, straight, at 0.1 "
    "to 0.4 m/s measures its resistance without any model; with the tubes off, that of its skin."
)


class CrossPrediction(NamedTuple):
    """Both directions of calibrating on one point and predicting the other."""

    before: list[Before]
    forward: list[After]
    """Calibrated at 5 Hz, predicting the optimum."""
    backward: list[After]


def allowed() -> float:
    """[m/s] by which a prediction may miss: twice both points' errors together."""
    return 2.0 * math.hypot(FIRST.error, OPTIMUM.error)


def before_error(x: CrossPrediction) -> float:
    """[m/s] by which the steady speed of the paper's equations misses the optimum, at least."""
    return min(b.steady for b in x.before if b.point == OPTIMUM.name) - OPTIMUM.speed


def speeds_verdict(x: CrossPrediction) -> tuple[str, After]:
    """The verdict, and the believed prediction nearest the published speed.

    What the paper leaves open may be filled in several ways. Where none of them passes nothing is
    explained; where fewer than half do, the outcome hangs on what is not known: inconclusive.
    """
    believed = [a for a in x.forward if a.believed] or x.forward
    best = min(believed, key=lambda a: abs(a.error))
    removes = {
        n: 1.0 - min(abs(a.error) for a in x.forward if a.resisting == n) / before_error(x)
        for n in RESISTING
    }
    passing = [a for a in x.forward if a.believed and abs(a.error) <= allowed()]
    if not passing:
        return UNEXPLAINED, best
    if 2 * len(passing) < sum(a.resisting == best.resisting for a in x.forward):
        return INCONCLUSIVE, best
    others = [n for n in RESISTING if n != best.resisting and removes[n] > AS_WELL]
    return (CLASS if others else IDENTIFIED), best


def speeds_sentence(x: CrossPrediction) -> str:
    """The verdict in words."""
    verdict, best = speeds_verdict(x)
    ends, steady = [b.by_stride[-1] for b in x.before], [b.steady for b in x.before]
    said = (
        f"Set free, the paper's equations pass {min(ends):.2f} to {max(ends):.2f} m/s in "
        f"{len(x.before[0].by_stride)} strides and settle at {min(steady):.1f} to "
        f"{max(steady):.1f} m/s, where the stroke itself gives out."
    )
    predicted = [a.predicted for a in x.forward]
    said += (
        f" {best.resisting} calibrated at 5 Hz predicts {100 * best.predicted:.1f} cm/s at the "
        f"optimum (published {100 * OPTIMUM.speed:.1f}, the paper's model "
        f"{100 * PAPER_MODEL_AT_OPTIMUM:.1f}) where the 5 Hz test is taken to be {best.gait}, "
        f"{best.head}; over all ways to fill in what the paper leaves open "
        f"{100 * min(predicted):.1f} to "
        f"{100 * max(predicted):.1f}."
    )
    if verdict == UNEXPLAINED:
        return said + " No value that is believed meets both points."
    if verdict == INCONCLUSIVE:
        said += " Something resists, but by how much hangs on what the paper leaves open."
    return said + " These two points cannot tell friction along the body from form drag."


def speeds_record(x: CrossPrediction, seconds: float) -> dict[str, Any]:
    """The content of report.json."""
    verdict, best = speeds_verdict(x)
    alone = verdict in (IDENTIFIED, UNEXPLAINED)
    others = [] if alone else [n for n in RESISTING if n != best.resisting]
    return {
        "verdict": verdict,
        "said": speeds_sentence(x),
        "effects": [
            {
                "name": best.resisting,
                "class": others,
                "parameters": {_parameter(best.resisting): _range(x.forward, best)},
                "where": "free swimming: mean force along the course",
            }
        ],
        "errors": {
            "speed_at_optimum": {
                "before": before_error(x), "after": abs(best.error), "floor": OPTIMUM.error,
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
        "after": [a.__dict__ | {"believed": a.believed} for a in [*x.forward, *x.backward]],
        "published": [
            {"name": p.name, "speed_m_per_s": p.speed, "error_m_per_s": p.error,
             "gaits": {n: g._asdict() for n, g in p.gaits.items()}}
            for p in (FIRST, OPTIMUM)
        ],
        "audit": [
            "Pressures and tail of the 5 Hz test are not in the paper: assumed, three ways.",
            "The paper gives no error for the 5 Hz speed: that of the optimum is assumed.",
        ],
        "next_experiment": NEXT,
        "settings": {
            "settling_strides": PLAN.settling, "corrections": PLAN.corrections,
            "steps_per_stride": PLAN.steps_per_stride, "nodes": PLAN.numerics.nodes,
        },
        "seconds": seconds,
        "versions": versions(),
    }  # fmt: skip


def _parameter(name: str) -> str:
    (parameter,) = RESISTING[name](0.0).priors()
    return parameter


def _range(found: list[After], best: After) -> dict[str, Any]:
    values = [a.coefficient for a in found if a.resisting == best.resisting]
    (prior,) = RESISTING[best.resisting](0.0).priors().values()
    return {
        "value": best.coefficient, "low": min(values), "high": max(values), "unit": prior.unit,
        "interval": "over what the paper leaves open",
    }  # fmt: skip


def _rows(found: list[After]) -> list[list[str]]:
    return [
        [
            a.resisting, a.head, a.gait, f"{a.coefficient:.3g}",
            "yes" if a.believed else "no", a.predicted_gait, f"{100 * a.predicted:.1f}",
            f"{100 * a.error:+.1f}",
        ]
        for a in found
    ]  # fmt: skip


HEAD = ["effect", "head", "calibrated with", "coefficient", "in prior", "predicted with",
        "cm/s", "off by"]  # fmt: skip


def speeds_table(x: CrossPrediction) -> str:
    """Predictions of the optimum in lines, for the terminal."""
    lines = [f"{'published':<44}{100 * OPTIMUM.speed:6.1f} cm/s"]
    for a in x.forward:
        lines.append(
            f"{a.resisting} = {a.coefficient:.3g}".ljust(44)
            + f"{100 * a.predicted:6.1f} cm/s  {a.gait}; {a.head}"
        )
    return "\n".join(lines)


def speeds_page(x: CrossPrediction, record: dict[str, Any]) -> str:
    """Returns report.html; `record` is the content of report.json."""
    return render_page(
        "free_swimming.html",
        title="The paper's free-swimming speeds",
        record=record,
        before_png=embedded_png(before_figure(x.before)),
        after_png=embedded_png(after_figure(x.forward)),
        head=HEAD,
        forward=_rows(x.forward),
        first_speed=FIRST.speed,
        backward=_rows(x.backward),
    )


def before_figure(found: list[Before]):
    """Speed stride by stride from rest, without resistance."""
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(9, 3.8), layout="constrained")
    shown = [b for b in found if b.head == found[0].head]
    for b in shown:
        axis.plot(np.arange(1, len(b.by_stride) + 1), b.by_stride, label=f"{b.point}\n{b.gait}")
    for point, colour in ((FIRST, "0.4"), (OPTIMUM, "k")):
        axis.axhline(point.speed, color=colour, ls=":", label=f"published, {point.name}")
    axis.set(xlabel="strides from rest", ylabel="speed (m/s)", ylim=(0.0, None))
    axis.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def after_figure(found: list[After]):
    """Predictions beside the published speed and its error."""
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(9, 3.6), layout="constrained")
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
