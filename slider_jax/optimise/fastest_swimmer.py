"""Optimises the speed of a swimmer: the task, the result and the written files."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.errors import InputError, SolverError
from slider_jax.experiment.load import Experiment, to_model, to_numerics
from slider_jax.experiment.schema import RobotTable
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.files import provenance, staged, write_json, write_text
from slider_jax.optimise.design_space import (
    VARIABLES,
    GaitBounds,
    gait_bounds,
    models,
    slope_of,
    speed_of,
    to_toml,
    with_gait,
)
from slider_jax.optimise.loop import (
    PLAN,
    Generation,
    OptimisationResult,
    run_optimiser,
    settings_of,
)
from slider_jax.optimise.optimiser import Optimiser
from slider_jax.optimise.population import Evaluation, is_first, shared_by_folder
from slider_jax.swimming.gait import Gait, to_swimmer
from slider_jax.swimming.paper_optimum import MEASURED_GAIT, PAPER_GAIT, PUBLISHED
from slider_jax.swimming.steady_state import SteadySettings, steady_speed

MESH = 31
"""Largest number of nodes for the comparison of designs. The speed on 31 nodes differs from the
speed on 51 nodes by at most 0.7 % for tails with an EI of 6 mN m^2 or more. The speed is 6 % too
high for a tail with an EI of 1 mN m^2. The report therefore also contains the speed of the best
design on the experiment's own mesh."""
STIFFEST = 10
"""Largest upper bound of the tail's EI, divided by the body's EI."""
ASCENDING = 2
"""Number of individuals whose gradients a device computes together. Gradient ascent has few
individuals, so only a small number per device occupies all cores."""


class Task(NamedTuple):
    """The experiment, the bounds and the numerical settings of an optimisation."""

    experiment: Experiment
    box: GaitBounds
    search: SteadySettings

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        bounds: Mapping[str, tuple[float, float] | None],
        steps_per_stride: int = 96,
    ) -> "Task":
        """Returns the task. Raises `InputError` for invalid bounds or if the wave is not square."""
        trial = experiment.trials[0]
        if trial.waveform != "square":
            raise InputError(
                f"trials.0.waveform: given {trial.waveform!r}; allowed 'square', the waveform of "
                "the optimised drive; the other trials are not used"
            )
        if not isinstance(experiment.robot, RobotTable):
            raise InputError(
                "robot.segments: given a robot of segments; allowed a uniform body and tail, "
                "because the optimised tail is uniform; give body_length, EI_body and so on"
            )
        nodes = min(MESH, experiment.numerics.nodes)
        numerics, scheme = to_numerics(experiment.with_values({"numerics.nodes": nodes}))
        search = SteadySettings(steps_per_stride=steps_per_stride, numerics=numerics, scheme=scheme)
        box = gait_bounds(bounds)
        stiffest = STIFFEST * experiment.robot.EI_body
        if box.high[-1] > stiffest:
            raise InputError.value(
                "--EI-tail",
                f"{box.high[-1]:g}",
                f"at most {stiffest:g} N m^2, {STIFFEST} times the body's EI",
                "in N m^2, not mN m^2",
            )
        for corner in (box.low, box.high):  # raises an error for an invalid corner
            to_swimmer(to_model(with_gait(experiment, Gait(*corner))))
        return cls(experiment, box, search)

    def settings(self) -> dict[str, Any]:
        """Returns all settings on which the speed of a design depends."""
        bounds = np.stack([self.box.low, self.box.high], axis=1).tolist()
        search = self.search._asdict()
        return {
            "experiment": self.experiment.model_dump(),
            "bounds": dict(zip(Gait._fields, bounds, strict=True)),
            "steps_per_stride": self.search.steps_per_stride,
            "nodes": self.search.numerics.nodes,
            "search": {name: x for name, x in search.items() if isinstance(x, (int, float))},
            "scheme": self.search.scheme.name,
            **provenance(),
        }


def search_fastest(
    task: Task,
    optimiser: Optimiser,
    population: int,
    generations: int,
    seed: int,
    folder: Path | None = None,
    resume: bool = False,
    on_generation: Callable[[Generation, float], None] = lambda generation, seconds: None,
) -> OptimisationResult:
    """Returns the fastest gait and tail; the arguments are as in `run_optimiser`.

    Raises `SolverError` if no individual of any generation has a steady speed.
    """
    if folder is not None and (folder / PLAN).exists():
        raise InputError(
            f"{folder / PLAN}: this folder holds a multimodal optimisation; give another folder"
        )
    depends = task.settings()
    speeds = shared_by_folder(Evaluation(speed_of(*task)), folder, depends)
    speeds_and_gradients = shared_by_folder(
        Evaluation(slope_of(*task), chunk=ASCENDING), folder, depends | {"gradients": True}
    )

    def evaluate(points: np.ndarray, gradients: bool) -> tuple[np.ndarray, np.ndarray | None]:
        return speeds_and_gradients(points) if gradients else (speeds(points), None)

    settings = settings_of(optimiser, population, seed, depends)
    found = run_optimiser(
        optimiser, evaluate, generations, seed, settings, folder, resume, is_first(), on_generation
    )
    if not np.isfinite(found.score):
        raise SolverError(
            f"no steady speed was found for any of {found.history[-1].evaluations} designs: a time "
            "step fails, or no effect such as head_drag resists motion along the body, so that the "
            "speed is far too high; add such an effect, or narrow the bounds"
        )
    return found


class Sensitivity(NamedTuple):
    """Derivatives of the steady speed with respect to the six variables at a design."""

    gradient: np.ndarray
    """Gradient (6,) of the speed [m/s per width of the bounds]."""
    hessian: np.ndarray
    """Hessian (6, 6) of the speed [m/s per product of two widths of the bounds]."""


def sensitivity(task: Task, unit: np.ndarray, step: float = 0.02) -> Sensitivity:
    """Returns gradient and Hessian of the steady speed at a point of the unit box.

    The implicit function theorem gives the gradient. Its central differences give the Hessian.
    """
    model, box = models(task.experiment), task.box

    def speed(x):
        gait = box.gait(x)
        return steady_speed(model(gait), gait.frequency, task.search._replace(of_derivatives=10))

    gradient = jax.jit(jax.jacfwd(speed))
    # Near a face of the unit box, both points of a difference move inside the box.
    middle = np.clip(unit, step, 1.0 - step)
    ends = ((jnp.asarray(middle + d), jnp.asarray(middle - d)) for d in step * np.eye(len(unit)))
    hessian = np.asarray([(gradient(a) - gradient(b)) / (2.0 * step) for a, b in ends])
    return Sensitivity(np.asarray(gradient(jnp.asarray(unit))), 0.5 * (hessian + hessian.T))


def speed_at(task: Task, gait: Gait) -> float:
    """Returns the steady speed [m/s] of a design, with the numerical settings of the task."""
    return float(jax.jit(speed_of(*task))(jnp.asarray(task.box.unit(gait))))


def write_optimum(
    task: Task, found: OptimisationResult, folder: Path, inputs: list[dict[str, Any]]
) -> dict[str, Any]:
    """Writes best.toml, optimum.json and optimum.png; returns the content of optimum.json.

    Without `inputs`, the robot is the paper's robot, and the content has the paper's optimum.
    """
    gait = Gait(*(float(x) for x in task.box.gait(found.best)))
    own, _ = to_numerics(task.experiment)
    finer = task._replace(search=task.search._replace(numerics=own))
    effects = to_model(task.experiment, 0).effects
    content = {
        "speed_m_per_s": found.score,
        "resisting": [e.name() for e in effects if e.resists_axially],
        "own_mesh": {"nodes": own.nodes, "speed_m_per_s": speed_at(finer, gait)},
        "gait": gait._asdict(),
        "paper": {
            "gait": PAPER_GAIT._asdict(),
            "speed_there_m_per_s": speed_at(task, PAPER_GAIT),
            "published_m_per_s": PUBLISHED["speed_m_per_s"]._asdict(),
        }
        if not inputs
        else None,
        "sensitivity": {"per": "width of the bounds", **sensitivity(task, found.best)._asdict()},
        "history": [x._asdict() for x in found.history],
        "last_population": {"unit_box": found.population, "scores": found.scores},
        "settings": task.settings(),
        "inputs": inputs,
    }  # fmt: skip
    comment = f"Steady speed {found.score:.5g} m/s, on {task.search.numerics.nodes} nodes."
    with staged(folder) as stage:
        write_text(stage / "best.toml", to_toml(with_gait(task.experiment, gait), comment))
        write_json(stage / "optimum.json", content)
        plot_search_history(found, stage / "optimum.png")
    return content


def optimum_summary(content: dict[str, Any]) -> list[str]:
    """Returns the lines of a table of the optimum, and of the paper's optimum if it is known."""
    gait, paper = content["gait"], content["paper"]
    gradient = content["sensitivity"]["gradient"]
    hessian = np.diag(content["sensitivity"]["hessian"])
    title = f"{'paper':>10}" if paper else ""
    lines = [f"{'':22}{'here':>10}{title}{'gradient':>12}{'curvature':>12}"]
    for i, (name, variable) in enumerate(VARIABLES.items()):
        label, factor = f"{name} ({variable.unit})", variable.factor
        there = f"{factor * paper['gait'][name]:10.4g}" if paper else ""
        lines.append(
            f"{label:22}{factor * gait[name]:10.4g}{there}"
            f"{1e2 * gradient[i]:12.3g}{1e2 * hessian[i]:12.3g}"
        )
    lines.append(
        "gradient and curvature of the speed [cm/s]; variables are divided by the bounds' widths"
    )
    own = content["own_mesh"]
    best = (
        f"best speed {1e2 * content['speed_m_per_s']:.2f} cm/s, on {own['nodes']} nodes "
        f"{1e2 * own['speed_m_per_s']:.2f} cm/s"
    )
    if paper:
        published = paper["published_m_per_s"]
        best += (
            f"; the paper's optimum: {1e2 * paper['speed_there_m_per_s']:.2f} cm/s in this model, "
            f"{1e2 * published['model']:.1f} cm/s in the paper's model, "
            f"{1e2 * published['experiment']:.1f} cm/s measured with a "
            f"tail of {1e3 * MEASURED_GAIT.tail_length:.0f} mm"
        )
    lines.append(best)
    if not content["resisting"]:
        lines.append(
            "no effect resists motion along the body, so the speed is far too high: add an effect "
            "such as head_drag"
        )
    return lines


def plot_search_history(found: OptimisationResult, path: Path) -> None:
    """Plots the best and the mean speed against the number of evaluations."""
    figure, axes = new_figure(figsize=(8, 4.5))
    at = [x.evaluations for x in found.history]
    best = [1e2 * x.best_here for x in found.history]
    axes.plot(at, [1e2 * x.best for x in found.history], "C3", label="best so far")
    axes.plot(at, best, "C0o", ms=3, label="best of generation")
    axes.plot(at, [1e2 * x.mean for x in found.history], "0.5", label="mean of generation")
    axes.set(xlabel="evaluations", ylabel="steady speed (cm/s)")
    axes.legend(fontsize="small", loc="lower right")
    save_figure(figure, path)
