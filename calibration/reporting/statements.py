"""Writes the table of the paper's statements as a page."""

from typing import Any

from calibration.reporting.html import render_page
from slider_jax.optimise.design_space import VARIABLES

COLUMNS = [
    "statement",
    "allowed",
    "unit",
    "built-in robot, or calculated",
    "joint assumptions",
    "verdict",
    "remarks",
]
FIGURES = ("fig4.png", "fig5.png", "fig6.png", "fig7_built-in_robot.png",
           "fig7_joint_assumptions.png", "fig7c.png", "fig8.png")  # fmt: skip


def statements_page(record: dict[str, Any]) -> str:
    """Returns the content of published.html; `record` is the content of published.json."""
    places: dict[str, list[list[str]]] = {}
    for x in record["statements"]:
        row = [x["text"], x["allowed"], x["unit"], _number(x["built_in"]),
               _number(x["fitted"]), x["verdict"], x["why"]]  # fmt: skip
        places.setdefault(x["place"], []).append(row)
    waves = record["wavelengths_m"]
    built_in, joint = record["settings"]["assumptions"].values()
    assumptions = [
        [name, _number(built_in[name]), _number(joint[name]),
         f"{x['low']:.4g} to {x['high']:.4g}", x["unit"], x["reason"]]
        for name, x in record["ranges"].items()
    ]  # fmt: skip
    optimum = [
        [name, *(f"{v.factor * x['gait'][k]:.4g}" for k, v in VARIABLES.items()),
         f"{100 * x['speed_m_per_s']:.1f}"]
        for name, x in record["optimum"].items()
    ]  # fmt: skip
    changed = [name for name in record["ranges"] if name not in ("EA", "damping_time")]
    return render_page(
        "statements.html",
        title="The paper's statements",
        record=record,
        places=places,
        head=COLUMNS,
        assumptions=assumptions,
        optimum_head=["", *(f"{k} ({v.unit})" for k, v in VARIABLES.items()), "speed (cm/s)"],
        optimum=optimum,
        searches=[
            [x["objective"], str(x["start"]), str(len(x["agree"])), *_front_facts(x)]
            for x in record["searches"]
        ],
        front_head=["peak thrust (mN)", "at (Hz)", "A_t (mm)", "speed (cm/s)", *changed],
        front=[
            [*_front_facts(x), *(_number(x["assumptions"][name]) for name in changed)]
            for x in record["front"]
        ],
        waves=[
            [kind, *(_number(x[kind], 1e3) for x in waves.values())]
            for kind in next(iter(waves.values()))
        ],
        robots=list(waves),
        figures=FIGURES,
    )


def statements_table(record: dict[str, Any]) -> str:
    """Returns the statements that a simulation checks, as a table for the terminal."""
    lines = [f"{'':34}{'paper':>18} {'unit':6}{'built-in':>10}{'joint':>10}"]
    for x in record["statements"]:
        if x["kind"] in ("simulated", "optimum"):
            name = x["name"].replace("_", " ")
            lines.append(
                f"{name:34}{x['allowed']:>18} {x['unit']:6}{_number(x['built_in']):>10}"
                f"{_number(x['fitted']):>10}  {x['verdict']}"
            )
    lines += [""] + [f"{number:4}  {verdict}" for verdict, number in record["counts"].items()]
    return "\n".join(lines)


def _number(x: float | None, factor: float = 1.0) -> str:
    return "" if x is None else f"{factor * x:.4g}"


def _front_facts(x: dict[str, Any]) -> list[str]:
    found = x["facts"]
    pairs = (("sweep_peak_N", 1e3), ("sweep_peak_Hz", 1.0), ("tail_amplitude_m", 1e3),
             ("speed_m_per_s", 100.0))  # fmt: skip
    return ["" if found[k] is None else f"{factor * found[k]:.3g}" for k, factor in pairs]
