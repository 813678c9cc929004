"""Runs the whole comparison with the paper and writes its table and its figures."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from slider_jax.io.files import provenance, staged, write_json, write_text
from slider_jax.optimise.report import plot_front
from slider_jax.reproduction.design_findings import findings
from slider_jax.reproduction.design_maps_report import plot_design_maps
from slider_jax.statements import figures
from slider_jax.statements.assumptions import RANGES, Assumptions
from slider_jax.statements.investigation import (
    GENERATIONS,
    POPULATION,
    SEED,
    Parts,
    RobotStudy,
    SwimSpeeds,
    evidence,
    study,
    sweep_thrusts,
)
from slider_jax.statements.joint_fit import FRONT_FACTS, Simulator
from slider_jax.statements.multimodal import judged_front
from slider_jax.statements.quantities import FINE
from slider_jax.statements.series import StrideSeries, head_fixed_stride, swimming_stride
from slider_jax.statements.statements import TOLERANCES
from slider_jax.statements.verdicts import (
    Evidence,
    counts,
    fitted_assumptions,
    joint_fit,
    judged,
    judged_maps,
    judged_optimum,
    summary_sentence,
)
from slider_jax.swimming.paper_optimum import (
    HEAD_DRAG,
    HEAD_DRAG_70_MM,
    MEASURED_GAIT,
    PAPER_GAIT,
    PUBLISHED,
)

SHOWN = (1.0, 4.8)
"""Frequencies [Hz] of the paper's Figs. 5 and 6."""
PUBLISHED_SPEED = PUBLISHED["speed_m_per_s"].model
ROBOTS = ("built-in robot", "joint assumptions")


def write_comparison(
    out: Path,
    page: Callable[[dict[str, Any]], str],
    program: str,
    progress: Callable[[str], None],
    front: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Writes published.json, published.html and the figures to `out`; returns the JSON content.

    `page` makes the page from this content. `front` is the result of `load_front`, for Fig. 9.
    Finished parts remain in `out` until the end, so that an interrupted run resumes. Parts of
    another `program` (a digest of the source files) are computed again.
    """
    searched = joint_fit()
    robots = dict(zip(ROBOTS, (Assumptions(), fitted_assumptions(searched)), strict=True))
    witnesses = {name: Assumptions(**x) for name, x in searched["witnesses"].items()}
    settings = {
        "assumptions": {name: x.values() for name, x in robots.items()},
        "steps_per_stride": FINE.search.steps_per_stride,
        "nodes": FINE.search.numerics.nodes,
        "frequencies_Hz": list(FINE.frequencies),
        "population": POPULATION,
        "generations": GENERATIONS,
        "program": program,
    }
    parts = Parts(out, settings)
    simulate, speeds = Simulator(FINE), SwimSpeeds()
    progress("compiling the simulation")
    thrusts = sweep_thrusts(list(robots.values()), parts)
    built_in, fitted = robots.values()
    found = evidence(simulate, built_in, fitted, witnesses, parts, progress)
    studies = {name: study(name, x, speeds, parts, progress) for name, x in robots.items()}
    swims = {name: swimming_stride(x) for name, x in robots.items()}
    checks = [findings(x.over_stiffness, x.over_phase) for x in studies.values()]
    optima = [(x.optimum, x.speed) for x in studies.values()]
    judgements = [
        *judged(found),
        *judged_maps(checks[0], checks[1]),
        *judged_optimum(optima, PUBLISHED_SPEED),
        *judged_front(front),
    ]
    content = {
        "said": summary_sentence(judgements),
        "counts": counts(judgements),
        "statements": [x._asdict() for x in judgements],
        "tolerances": TOLERANCES,
        "ranges": {name: x._asdict() for name, x in RANGES.items()},
        "optimum": {
            "paper": {"gait": PAPER_GAIT._asdict(), "speed_m_per_s": PUBLISHED_SPEED},
            **{
                name: {"gait": x.optimum._asdict(), "speed_m_per_s": x.speed}
                for name, x in studies.items()
            },
        },
        "sweep_thrust_N": dict(zip(robots, thrusts, strict=True)),
        "wavelengths_m": {name: x for name, (_, x) in swims.items()},
        "maps": {name: _map_record(x) for name, x in studies.items()},
        "facts": {"built-in robot": found.built_in, "joint assumptions": found.fitted},
        "single_changes": _change_records(found),
        "head_drag": parts.get("head drag", partial(_head_drags, built_in, speeds)),
        "multimodal": front,
        "searches": searched["searches"],
        "refined": searched["refined"],
        "front": searched["front"],
        "evaluated": searched["evaluated"],
        "settings": settings,
        "seed": SEED,
        **provenance(),
    }
    progress("drawing the figures")
    with staged(out) as stage:
        series = {name: x for name, (x, _) in swims.items()}
        content["figures"] = _draw(robots, thrusts, studies, series, front, stage)
        write_json(stage / "published.json", content)
        plain = json.loads((stage / "published.json").read_text(encoding="utf-8"))
        write_text(stage / "published.html", page(plain))
    parts.remove()
    return plain


def _draw(
    robots: dict[str, Assumptions],
    thrusts: np.ndarray,
    studies: dict[str, RobotStudy],
    swims: dict[str, StrideSeries],
    front: dict[str, Any] | None,
    out: Path,
) -> list[str]:
    """Draws the figures into `out` and returns their names."""
    named = dict(zip(robots, thrusts, strict=True))
    figures.plot_thrust_sweep(np.array(FINE.frequencies), named, out / "fig4.png")
    for number, frequency in zip((5, 6), SHOWN, strict=True):
        strides = {name: head_fixed_stride(x, frequency) for name, x in robots.items()}
        figures.plot_strides(strides, frequency, out / f"fig{number}.png")
    for name, x in studies.items():
        path = out / f"fig7_{name.replace(' ', '_')}.png"
        plot_design_maps(x.over_stiffness, x.over_phase, f"{name}, 5 Hz", path)
    figures.plot_length_slice(studies, out / "fig7c.png")
    figures.plot_swimmer(swims, out / "fig8.png")
    if front is not None:
        plot_front(front["front"], front["only"], out / "fig9.png")
    return sorted(path.name for path in out.glob("*.png"))


def _change_records(found: Evidence) -> list[dict[str, Any]]:
    """Returns the main facts of the built-in robot if one assumption is at an end of its range."""
    rows = []
    for name, one in RANGES.items():
        built_in = getattr(Assumptions(), name)
        ends = (one.low, one.high)
        for changed, value, facts in found.changed:
            at_end = np.isclose(value, ends, atol=0.0).any()
            if changed == name and at_end and not np.isclose(value, built_in, atol=0.0):
                row = {key: facts[key] for key in FRONT_FACTS}
                rows.append({"assumption": name, "value": value, "facts": row})
    return rows


def _head_drags(built_in: Assumptions, speeds: SwimSpeeds) -> list[dict[str, Any]]:
    """Returns the speeds with both drag areas of the head, with the tails of 53 and 70 mm."""
    gaits = {"speed_53_mm_m_per_s": PAPER_GAIT, "speed_70_mm_m_per_s": MEASURED_GAIT}
    rows = []
    for area in (HEAD_DRAG, HEAD_DRAG_70_MM):
        found = speeds(replace(built_in, head_drag=area), np.array(list(gaits.values()), float))
        rows.append({"area_m2": area, **dict(zip(gaits, found.tolist(), strict=True))})
    return rows


def _map_record(x: RobotStudy) -> dict[str, Any]:
    return {
        "tail_length_m": x.over_stiffness.lengths,
        "EI_tail_N_m2": x.over_stiffness.across,
        "speed_over_EI_m_per_s": x.over_stiffness.speed,
        "phase": x.over_phase.across,
        "speed_over_phase_m_per_s": x.over_phase.speed,
    }
