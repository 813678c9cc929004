"""Writes the files, the table and the picture of a Pareto front."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.climbing.climb import simulate_climb
from slider_jax.experiment.load import to_numerics
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.files import provenance, staged, write_json, write_text
from slider_jax.optimise.design_space import to_toml, with_gait
from slider_jax.optimise.pareto_front import Front, dominated
from slider_jax.optimise.two_tasks import NAMES, TwoTasks, swim_efficiency

SHOWN = (
    ("tail_length", "tail length (mm)", 1e3),
    ("EI_tail", "EI of the tail (mN m$^2$)", 1e3),
    ("frequency", "frequency (Hz)", 1.0),
    ("front", "pressures (kPa)", 1e-3),
    ("phase", "phase (of a period)", 1.0),
)
"""Plotted variable, axis label, and factor from the SI unit to the unit in the label. If swimmer
and climber have different values, the panel shows both. "front" also shows the rear pressures."""


CONVERGED = 0.99
"""Least part of the largest efficiency that the optimisation of one task alone has to reach. Below
it, the optimisations were too short."""


def front_records(modes: TwoTasks, front: Front) -> list[dict[str, Any]]:
    """Returns each point of the front as a record for JSON, in SI units."""
    own = to_numerics(modes.task.experiment)[0]
    finer = modes.task.search._replace(numerics=own)
    E_swim = jax.jit(swim_efficiency(modes.task.experiment, finer))
    designs = {point.design.tobytes(): point.design for point in front.points}
    again = {
        key: on_own_mesh(modes, design, E_swim) | {"nodes": own.nodes}
        for key, design in designs.items()
    }
    return [
        {
            "beta": point.beta,
            "eta": point.eta,
            "E_swim": point.efficiencies[0],
            "E_climb": point.efficiencies[1],
            **dict(zip(NAMES, modes.values(point.design).tolist(), strict=True)),
            "own_mesh": again[point.design.tobytes()],
        }
        for point in front.points
    ]


def on_own_mesh(
    modes: TwoTasks, design: np.ndarray, E_swim: Callable[[jax.Array], jax.Array]
) -> dict[str, Any]:
    """Returns the efficiencies of a design, simulated on the experiment's own mesh."""
    swims, climbs, pin = modes.gaits(design)
    climbed = simulate_climb(with_gait(modes.task.experiment, climbs), 0, pin)
    return {
        "E_swim": float(E_swim(jnp.asarray(swims))),
        "E_climb": float(climbed.found.efficiency),
        "climb_unaccounted_of_power": float(climbed.found.unaccounted),
        "climb_repeats_after_strides": climbed.period or None,
    }


def write_front(
    modes: TwoTasks,
    front: Front,
    effort: dict[str, Any],
    folder: Path,
    inputs: list[dict[str, Any]],
) -> dict[str, Any]:
    """Writes multimodal.json, multimodal.png and experiments; returns the content of the JSON."""
    found, only = front_records(modes, front), {"E_swim": front.only[0], "E_climb": front.only[1]}
    content = {
        "front": found,
        "only": only,
        "alone": {"E_swim": front.alone[0], "E_climb": front.alone[1]},
        "dominated_by_a_neighbour": dominated(front.points),
        "evaluations": front.evaluations,
        "effort": effort,
        "settings": modes.settings(),
        "inputs": inputs,
        **provenance(),
    }
    with staged(folder) as stage:
        for row, point in zip(found, front.points, strict=True):
            swims, climbs, pin = modes.gaits(point.design)
            own = row["own_mesh"]
            for task, gait, comment in (
                ("swim", swims, f"Froude efficiency {own['E_swim']:.4g}."),
                ("climb", climbs, f"m g U/P {own['E_climb']:.4g} with --pin-phase {pin:.6g}."),
            ):
                text = to_toml(with_gait(modes.task.experiment, gait), comment)
                write_text(stage / f"beta_{point.beta:.3f}_{task}.toml", text)
        write_json(stage / "multimodal.json", content)
        plot_front(found, only, stage / "multimodal.png")
    return content


def front_summary(content: dict[str, Any]) -> list[str]:
    """Returns text lines: a table with a row for each beta, and remarks."""
    lines = [
        f"{'beta':>6}{'eta':>8}{'E_swim':>9}{'E_climb':>9}{'tail mm':>9}{'mN m^2':>8}"
        f"{'swim Hz':>9}{'kPa':>9}{'phase':>7}{'climb Hz':>10}{'kPa':>9}{'phase':>7}{'pin':>6}"
    ]
    for x in content["front"]:
        swims, climbs = (
            f"{1e-3 * x[f'{task}front']:.0f}/{1e-3 * x[f'{task}rear']:.0f}"
            for task in ("", "climb_")
        )
        lines.append(
            f"{x['beta']:6.3f}{x['eta']:8.4f}{x['E_swim']:9.4f}{x['E_climb']:9.4f}"
            f"{1e3 * x['tail_length']:9.1f}{1e3 * x['EI_tail']:8.2f}"
            f"{x['frequency']:9.2f}{swims:>9}{x['phase']:7.2f}"
            f"{x['climb_frequency']:10.2f}{climbs:>9}{x['climb_phase']:7.2f}{x['pin_phase']:6.2f}"
        )
    only, total = content["only"], sum(content["evaluations"].values())
    lines.append(
        f"largest efficiency: E_swim {only['E_swim']:.4f}, E_climb {only['E_climb']:.4f}; "
        f"{total} evaluations"
    )
    for name, found in content["alone"].items():
        if found < CONVERGED * only[name]:
            lines.append(
                f"the optimisation of {name} alone reached {found:.4f}, less than a later "
                "optimisation; repeat the command with more --generations in a new folder"
            )
    for name in ("E_swim", "E_climb"):
        own = ", ".join(f"{x['own_mesh'][name]:.4f}" for x in content["front"])
        lines.append(f"{name} on {content['front'][0]['own_mesh']['nodes']} nodes: {own}")
    steady = "climb_repeats_after_strides"
    if other := [f"{x['beta']:.3f}" for x in content["front"] if x["own_mesh"][steady] is None]:
        lines.append(f"beta {', '.join(other)}: the strides of the climb do not repeat")
    if content["dominated_by_a_neighbour"]:
        lines.append(f"beta {content['dominated_by_a_neighbour']}: a neighbouring design dominates")
    return lines


def plot_front(found: list[dict[str, Any]], only: dict[str, float], path: Path) -> None:
    """Plots the front and the optimal variables against beta.

    As in the paper's Fig. 9, the tail is black, swimming is blue and climbing is red.
    """
    figure, axes = new_figure(2, 3, figsize=(11, 6.5))
    beta = np.array([x["beta"] for x in found])
    front, *others = axes.flat
    shares = [[x[name] / only[name] for x in found] for name in ("E_swim", "E_climb")]
    front.plot(*shares, "k-", lw=0.8)
    points = front.scatter(*shares, c=beta, cmap="viridis", zorder=3)
    front.set(xlabel="E_swim/E_swim,only", ylabel="E_climb/E_climb,only")
    figure.colorbar(points, ax=front, label="beta")
    for (name, label, factor), ax in zip(SHOWN, others, strict=True):
        of_tail = name in ("tail_length", "EI_tail")
        shown = [(name, "k-" if of_tail else "C0o-", "both" if of_tail else "swimming")]
        if f"climb_{name}" in found[0]:
            shown.append((f"climb_{name}", "C3s-", "climbing"))
        if name == "front":
            shown.append(("rear", "C0o--", "swimming, rear"))
            shown.append(("climb_rear", "C3s--", "climbing, rear"))
        if name == "phase":
            shown.append(("pin_phase", "C3^:", "pin"))
        for key, style, text in shown:
            ax.plot(beta, [factor * x[key] for x in found], style, ms=4, lw=1.0, label=text)
        ax.set(xlabel="beta (0: climbing, 1: swimming)", ylabel=label)
        if len(shown) > 1:
            ax.legend(fontsize="x-small")
    save_figure(figure, path)
