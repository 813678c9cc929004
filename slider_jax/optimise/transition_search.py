"""Optimises the way from the water to the wall: a gait to swim, a gait to climb, and one tail.

The score is the mean speed of the head from the start to the goal. If the head does not reach the
goal in time, the score is the speed to its height at the end. The schedule has the swimming gait
until `switch`, and the climbing gait from `CHANGE` later on; all values are linear in between.

Each part is also optimised alone, with its own tail: swimming from the start to the edge of the
wall, and climbing in air from there to the goal. The sum of both times is the time of a robot that
changes its tail on the way and loses nothing at the surface.
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar
from slider_jax.beam.waterline import Waterline
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.rollout import TimeGrid, continued
from slider_jax.dynamics.step import at_rest
from slider_jax.errors import InputError, SolverError
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.schema import RobotTable
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.files import provenance, staged, write_json, write_text
from slider_jax.io.toml import significant
from slider_jax.optimise.design_space import to_toml
from slider_jax.optimise.loop import OptimisationResult, run_optimiser, settings_of
from slider_jax.optimise.optimiser import OPTIMISERS, cma_es
from slider_jax.optimise.population import Evaluation, SharedEvaluation, is_first, shared_by_folder
from slider_jax.swimming.gait import CAP
from slider_jax.transition.crossing import CrossingSettings, GaitSchedule, to_crosser, with_schedule
from slider_jax.transition.run import crossing_settings, simulate_transition, transition_record

CHANGE = 0.5
"""Duration [s] of the change from the swimming gait to the climbing gait: some strides."""
CROSSING_BOUNDS = {
    "swim_frequency": (1.0, 7.0),
    "swim_front": (50e3, 448e3),
    "swim_rear": (50e3, 448e3),
    "swim_phase": (-0.5, 0.5),
    "switch": (0.5, 10.0),
    "climb_frequency": (1.0, 4.0),
    "climb_front": (50e3, CAP),
    "climb_rear": (50e3, CAP),
    "climb_phase": (-0.5, 0.5),
    "grip_phase": (-0.5, 0.5),
    "tail_length": (0.020, 0.100),
    "EI_tail": (0.001, 0.038),
}
"""Bounds of the design variables in SI units: those of `slider optimize swim` and of the climber in
`slider optimize multimodal`, and an assumed range of the time of the switch."""
TAILS = ("tail_length", "EI_tail")
GAITS = ("frequency", "front", "rear", "phase")
PARTS = {
    "swim": (*(f"swim_{x}" for x in GAITS), *TAILS),
    "climb": (*(f"climb_{x}" for x in GAITS), "grip_phase", *TAILS),
    "transition": tuple(CROSSING_BOUNDS),
}
"""Design variables of each part alone, and of the whole way."""
START = {
    "swim_frequency": 5.5,
    "swim_front": 400e3,
    "swim_rear": 350e3,
    "swim_phase": 0.14,
    "switch": 4.0,
    "climb_frequency": 2.0,
    "climb_front": 160e3,
    "climb_rear": 160e3,
    "climb_phase": 0.0,
    "grip_phase": 0.0,
    "tail_length": 0.06,
    "EI_tail": 0.012,
}
"""Mean of the first generation of each part alone: near the paper's gaits."""
WIDE, NARROW = 0.25, 0.12
"""Standard deviation of the first generation, as a fraction of the bounds: of each part alone, and
of the whole way, which starts from the best designs of both parts."""
FAR = 100.0
"""Depth [m] of the surface for climbing alone, and height of the wall for swimming alone."""


class CrossingTask(NamedTuple):
    """The experiment, the bounds and the numerical settings of the optimisations."""

    experiment: Experiment
    bounds: dict[str, tuple[float, float]]
    settings: CrossingSettings

    @classmethod
    def of(
        cls, experiment: Experiment, bounds: Mapping[str, tuple[float, float] | None]
    ) -> "CrossingTask":
        """Returns the task; `bounds` replace entries of `CROSSING_BOUNDS`.

        Raises `InputError` as `to_crosser` does, and for invalid bounds.
        """
        to_crosser(experiment)
        if not isinstance(experiment.robot, RobotTable):
            raise InputError(
                "robot.segments: given a robot of segments; allowed a uniform body and tail, "
                "because the optimised tail is uniform"
            )
        chosen = CROSSING_BOUNDS | {name: x for name, x in bounds.items() if x is not None}
        for name, (low, high) in chosen.items():
            if not low < high:
                option = f"--{name.replace('_', '-')}"
                raise InputError.value(option, f"{low:g} {high:g}", "LOW HIGH with LOW < HIGH")
        fastest = max(chosen["swim_frequency"][1], chosen["climb_frequency"][1])
        if experiment.numerics.step > 0.05 / fastest:
            longest = f"at most {0.05 / fastest:.4g} s, a twentieth of the shortest period"
            raise InputError.value("numerics.step", f"{experiment.numerics.step:g}", longest)
        return cls(experiment, chosen, crossing_settings(experiment))

    def box(self, part: str) -> tuple[np.ndarray, np.ndarray]:
        """Returns the lower and the upper bounds of a part's variables, in SI units."""
        low, high = np.array([self.bounds[name] for name in PARTS[part]]).T
        return low, high

    def values(self, part: str, unit: Float[Array, " n"] | np.ndarray) -> dict[str, Scalar]:
        """Returns all design variables at a point of a part's unit box.

        A part alone has one gait throughout, so the other part's variables have no influence.
        """
        low, high = self.box(part)
        x = low + unit * (high - low)
        found: dict[str, Scalar] = dict(START)
        found |= {name: x[i] for i, name in enumerate(PARTS[part])}
        if part != "transition":
            other = "climb" if part == "swim" else "swim"
            found |= {f"{other}_{name}": found[f"{part}_{name}"] for name in GAITS}
        return found

    def unit(self, part: str, values: Mapping[str, Scalar]) -> np.ndarray:
        """Returns the point of a part's unit box that is nearest to the values."""
        low, high = self.box(part)
        x = np.array([float(values[name]) for name in PARTS[part]])
        return np.clip((x - low) / (high - low), 0.0, 1.0)

    def way(self, part: str) -> float:
        """Returns the length [m] of a part of the way."""
        table = self.experiment.transition
        assert table is not None
        lengths = {
            "swim": table.depth + table.wall_from,
            "climb": table.height - table.wall_from,
            "transition": table.depth + table.height,
        }
        return lengths[part]

    def record(self) -> dict[str, Any]:
        """Returns all settings on which the score of a design depends."""
        return {
            "experiment": self.experiment.model_dump(),
            "bounds": {name: list(x) for name, x in self.bounds.items()},
            "step_s": self.settings.step,
            "nodes": self.settings.numerics.nodes,
            **provenance(),
        }


def schedule_from(x: Mapping[str, Scalar]) -> GaitSchedule:
    """Returns the schedule (three knots) of the design variables."""

    def knots(swim, climb):
        return jnp.stack([jnp.asarray(v, float) for v in (swim, swim, climb)])

    switch, zero = jnp.asarray(x["switch"], float), jnp.zeros(3)
    gait = {name: knots(x[f"swim_{name}"], x[f"climb_{name}"]) for name in GAITS}
    return GaitSchedule(
        time=jnp.stack([jnp.zeros(()), switch, switch + CHANGE]),
        **gait,
        bias=zero,
        grip_phase=zero + x["grip_phase"],
    )


def _part_model(base: Model, part: str) -> Model:
    """Returns the model of a part: swimming without a wall, or climbing without water."""
    if part == "swim":
        return eqx.tree_at(lambda m: m.support.wall_from, base, jnp.asarray(FAR))
    if part == "climb":
        line = base.waterline
        assert line is not None
        dry = Waterline(jnp.asarray(-FAR), line.up, line.thickness)
        where = lambda m: (m.waterline, m.support.wall_from)  # noqa: E731
        return eqx.tree_at(where, base, (dry, jnp.asarray(-FAR)))
    return base


def crossing_speed(
    task: CrossingTask, part: str
) -> Callable[[Float[Array, " n"]], Float[Array, ""]]:
    """Returns the score [m/s] of a point of the unit box of a part; NaN if a time step fails."""
    table, settings = task.experiment.transition, task.settings
    assert table is not None
    base, way = _part_model(to_crosser(task.experiment), part), task.way(part)
    span = settings.step * settings.block
    blocks = int(np.ceil(table.duration / span))

    def speed(unit):
        x = task.values(part, unit)
        robot = base.robot.with_tail(x["tail_length"], x["EI_tail"])
        model = with_schedule(eqx.tree_at(lambda m: m.robot, base, robot), schedule_from(x))

        def block(state):
            number, carry, _ = state
            times = TimeGrid(settings.step, settings.block, number * span)
            run = continued(
                carry, model, times, lambda x: x.head[0], settings.numerics, settings.scheme
            )
            above = run.saved >= way
            first = times.times[jnp.argmax(above)]
            return number + 1.0, run.final, jnp.where(jnp.any(above), first, jnp.inf)

        def unfinished(state):
            number, carry, arrival = state
            return (number < blocks) & carry.ok & jnp.isinf(arrival)

        begin = jnp.zeros(()), at_rest(model, settings.numerics), jnp.asarray(jnp.inf)
        _, carry, arrival = jax.lax.while_loop(unfinished, block, begin)
        short = carry.memory.head[0] / (blocks * span)
        score = jnp.where(jnp.isinf(arrival), short, way / arrival)
        return jnp.where(carry.ok, score, jnp.nan)

    return speed


def _scores(
    speeds: Evaluation | SharedEvaluation, points: np.ndarray, gradients: bool
) -> tuple[np.ndarray, None]:
    return speeds(points), None


class CrossingEffort(NamedTuple):
    """The effort of a search; the whole way has all `generations`, and each part alone half."""

    population: int = 16
    generations: int = 40
    seed: int = 0

    def of(self, part: str) -> int:
        """Returns the number of generations of a part."""
        return self.generations if part == "transition" else max(1, self.generations // 2)


def search_crossing(
    task: CrossingTask,
    effort: CrossingEffort,
    folder: Path | None = None,
    resume: bool = False,
    on_generation: Callable[..., None] = lambda part, generation, seconds: None,
) -> dict[str, OptimisationResult]:
    """Optimises each part alone, and then the whole way, by CMA-ES; returns the results by part.

    Each part has a folder with a checkpoint in `folder`. With `resume`, the search continues from
    these checkpoints. Raises `SolverError` if all designs of a part fail.
    """
    fewest, _ = OPTIMISERS["cma-es"]
    if effort.population < fewest:
        raise InputError.value("--population", effort.population, f"{fewest} or more individuals")
    found: dict[str, OptimisationResult] = {}
    for part, names in PARTS.items():
        start: dict[str, Scalar] = dict(START)
        spread = WIDE
        if part == "transition":
            swim, climb = (task.values(x, found[x].best) for x in ("swim", "climb"))
            start = climb | {name: x for name, x in swim.items() if name.startswith("swim_")}
            start |= {name: 0.5 * (swim[name] + climb[name]) for name in TAILS}
            start["switch"] = task.way("swim") / found["swim"].score
            spread = NARROW
        report = partial(on_generation, part)
        optimiser = cma_es(effort.population, len(names), task.unit(part, start), spread)
        place = None if folder is None else folder / part
        if place is not None:
            place.mkdir(parents=True, exist_ok=True)
        depends = {"part": part, **task.record()}
        speeds = shared_by_folder(Evaluation(crossing_speed(task, part)), folder, depends)
        settings = settings_of(optimiser, effort.population, effort.seed, depends)
        found[part] = run_optimiser(
            optimiser,
            partial(_scores, speeds),
            effort.of(part),
            effort.seed,
            settings,
            place,
            resume,
            is_first(),
            report,
        )
        if not np.isfinite(found[part].score):
            raise SolverError(
                f"{part}: a time step fails for every design; use a shorter numerics.step or "
                "narrower bounds"
            )
    return found


def with_crossing(task: CrossingTask, unit: np.ndarray, refine: float = 1.0) -> Experiment:
    """Returns the experiment with the best schedule and tail; `refine` refines mesh and steps."""
    x = {name: significant(float(v), 10) for name, v in task.values("transition", unit).items()}
    schedule = schedule_from(x)
    rows = [
        {name: significant(float(getattr(schedule, name)[i]), 10) for name in GaitSchedule._fields}
        for i in range(len(schedule.time))
    ]
    numerics = task.experiment.numerics
    changes = {
        "transition.schedule": rows,
        "robot.tail_length": x["tail_length"],
        "robot.EI_tail": x["EI_tail"],
        "numerics.nodes": round(refine * (numerics.nodes - 1)) + 1,
        "numerics.step": significant(numerics.step / refine, 6),
    }
    return task.experiment.with_values(changes, "design")


def write_crossing(
    task: CrossingTask,
    found: dict[str, OptimisationResult],
    effort: CrossingEffort,
    folder: Path,
    inputs: list[dict[str, Any]],
) -> dict[str, Any]:
    """Writes best.toml, optimum.json and optimum.png; returns the content of optimum.json."""
    best = with_crossing(task, found["transition"].best)
    runs = {
        "search": transition_record(simulate_transition(best)),
        "refined": transition_record(
            simulate_transition(with_crossing(task, found["transition"].best, 2.0))
        ),
    }
    content = {
        "parts": {
            part: {
                "way_m": task.way(part),
                "speed_m_per_s": result.score,
                "time_s": _time(task, part, result.score),
                "design": {
                    name: float(x)
                    for name, x in task.values(part, result.best).items()
                    if name in PARTS[part]
                },
                "history": [x._asdict() for x in result.history],
            }
            for part, result in found.items()
        },
        "transition": runs["search"],
        "on_refined_mesh": runs["refined"],
        "effort": effort._asdict(),
        "settings": task.record(),
        "inputs": inputs,
    }
    with staged(folder) as stage:
        comment = f"{runs['search']['reason']}; found by slider optimize transition."
        write_text(stage / "best.toml", to_toml(best, comment))
        write_json(stage / "optimum.json", content)
        plot_crossing_search(found, stage / "optimum.png")
    return content


def _time(task: CrossingTask, part: str, score: float) -> float | None:
    """Returns the time [s] to the goal of a part; None if the best design does not reach it."""
    table = task.experiment.transition
    assert table is not None
    time = task.way(part) / score if score > 0.0 else np.inf
    span = task.settings.step * task.settings.block
    return time if time <= span * np.ceil(table.duration / span) else None


def crossing_summary(content: dict[str, Any]) -> list[str]:
    """Returns the lines of a table of the optimum, and of both parts alone."""
    parts, coarse = content["parts"], content["transition"]
    names = list(CROSSING_BOUNDS)
    lines = [
        f"{'variable (SI unit)':18}"
        + "".join(f"{part + ' alone':>16}" for part in ("swim", "climb"))
    ]
    lines[0] += f"{'transition':>16}"
    for name in names:
        cells = [parts[part]["design"].get(name) for part in PARTS]
        lines.append(f"{name:18}" + "".join(f"{'-' if x is None else f'{x:.5g}':>16}"
                                            for x in cells))  # fmt: skip
    for label, key in (("way (m)", "way_m"), ("speed (m/s)", "speed_m_per_s"),
                       ("time (s)", "time_s")):  # fmt: skip
        values = [parts[part][key] for part in PARTS]
        lines.append(f"{label:18}" + "".join(f"{'-' if x is None else f'{x:.4g}':>16}"
                                             for x in values))  # fmt: skip
    lines.append(coarse["reason"])
    finer = content["on_refined_mesh"]
    if coarse["time_to_goal_s"] and finer["time_to_goal_s"]:
        change = finer["time_to_goal_s"] / coarse["time_to_goal_s"] - 1.0
        lines.append(
            f"on {finer['nodes']} nodes with {finer['steps_per_s']:.0f} steps/s, the time to the "
            f"goal changes by {100.0 * change:+.1f} %"
        )
        alone = [parts[part]["time_s"] for part in ("swim", "climb")]
        if None not in alone:
            lines.append(
                f"both parts at their own optimum take {sum(alone):.1f} s; the transition takes "
                f"{coarse['time_to_goal_s'] / sum(alone):.2f} times as long"
            )
    else:
        lines.append(f"on the refined mesh: {finer['reason']}")
    return lines


def plot_crossing_search(found: dict[str, OptimisationResult], path: Path) -> None:
    """Plots the best and the mean speed of each part against the number of evaluations."""
    figure, axes = new_figure(1, 3, figsize=(11, 3.6))
    for axis, (part, result) in zip(axes, found.items(), strict=True):
        at = [x.evaluations for x in result.history]
        for name, style in (("best", "C3"), ("best_here", "C0o"), ("mean", "0.5")):
            label = {"best": "best so far", "best_here": "best of generation"}.get(name, name)
            axis.plot(at, [1e2 * getattr(x, name) for x in result.history], style, ms=3,
                      label=label)  # fmt: skip
        axis.set_title(part if part == "transition" else f"{part} alone", fontsize="medium")
        axis.set(xlabel="evaluations")
    axes[0].set(ylabel="mean speed (cm/s)")
    axes[0].legend(fontsize="small", loc="lower right")
    save_figure(figure, path)
