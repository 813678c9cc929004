"""Simulates a trial for many values of one or two fields; an interrupted sweep resumes.

Several processes that run the same sweep in the same folder share its chunks.
"""

import hashlib
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.batch.chunks import available_cores, chunks_of, run_in_threads, stack, take
from slider_jax.batch.strides import POSES, BatchRobot, Plan, run_strides, steady_quantities
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, to_model, to_numerics
from slider_jax.io.files import json_text, provenance, write_first
from slider_jax.io.sharing import PAUSE, SharedFolder
from slider_jax.io.toml import field_at, quantity_of
from slider_jax.swimming.gait import to_swimmer
from slider_jax.swimming.performance import performance_table, swim_performance

LARGEST_CHUNK = 8


class Axis(NamedTuple):
    """A field of the experiment, such as `trials.0.frequency`, and the values of this field."""

    field: str
    values: tuple[float, ...]

    @classmethod
    def spaced(cls, field: str, start: float, stop: float, count: int) -> "Axis":
        """Returns `count` evenly spaced values. Raises `InputError` for an invalid range."""
        if count < 2:
            raise InputError.value(f"--count of {field}", count, "2 or more values")
        if not np.isfinite([start, stop]).all() or start == stop:
            given = f"{start} to {stop}"
            raise InputError.value(f"range of {field}", given, "two different finite numbers")
        return cls(field, tuple(float(x) for x in np.linspace(start, stop, count)))

    @property
    def unit(self) -> str:
        """Unit of the field; empty for a field without a unit."""
        quantity = quantity_of(field_at(Experiment, self.field.split("."))[1])
        return quantity.unit if quantity else ""

    @property
    def column(self) -> str:
        """Name of the field's column in a table, with the unit."""
        unit = self.unit.replace(" ", "_").replace("/", "_per_").replace("^", "")
        return f"{self.field}_{unit}" if unit and " of " not in self.unit else self.field


class Sweep(NamedTuple):
    """The experiment, the axes, the trial and the settings of a sweep."""

    experiment: Experiment
    axes: tuple[Axis, ...]
    trial: int = 0
    strides: int = 8
    transient: int = 3
    steps_per_stride: int = 300
    swim: bool = False
    """Whether the robot swims freely; the results then describe its steady stride."""

    @property
    def points(self) -> list[tuple[float, ...]]:
        """Values of the axes at every point. The values of the last axis change fastest."""
        grids = np.meshgrid(*(axis.values for axis in self.axes), indexing="ij")
        return [tuple(map(float, row)) for row in np.stack([g.ravel() for g in grids], axis=1)]

    def settings(self) -> dict[str, Any]:
        """Returns everything that the result depends on, as JSON types."""
        content = {
            "experiment": self.experiment.model_dump(),
            **({"profiles": found} if (found := self.experiment.profiles) else {}),
            "fields": {axis.field: axis.values for axis in self.axes},
            "trial": self.trial,
            "strides": self.strides,
            "transient": self.transient,
            "steps_per_stride": self.steps_per_stride,
            "swim": self.swim,
            **provenance(),
        }
        return json.loads(json.dumps(content))


def digest(settings: dict[str, Any]) -> str:
    """Returns the SHA-256 checksum of settings."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


class Group(NamedTuple):
    """Points of a sweep that share one compiled program."""

    plan: Plan
    members: BatchRobot
    """Robots of the points, stacked along the first axis."""
    points: np.ndarray
    """Indices of the points in the sweep."""


def groups_of(sweep: Sweep) -> list[Group]:
    """Returns groups of points that share a program. Only [numerics] may need several groups.

    Raises `InputError` for a field that does not affect the strides.
    """
    _check(sweep)
    cases = [_case(sweep, point) for point in sweep.points]
    for number, axis in enumerate(sweep.axes):
        other = list(sweep.points[0])
        other[number] = axis.values[-1]
        (plan, member), (other_plan, changed) = cases[0], _case(sweep, tuple(other))
        leaves = zip(jax.tree.leaves(member), jax.tree.leaves(changed), strict=True)
        if plan == other_plan and all(np.array_equal(a, b) for a, b in leaves):
            raise InputError(
                f"--field {axis.field}: this field does not affect the strides of trial "
                f"{sweep.trial}; allowed are numbers of robot, parameters, water, effects, "
                "numerics, and of the simulated trial (--trial)"
            )
    plans = list(dict.fromkeys(plan for plan, _ in cases))
    indices = [np.array([i for i, case in enumerate(cases) if case[0] == x]) for x in plans]
    return [
        Group(plan, stack([cases[i][1] for i in points]), points)
        for plan, points in zip(plans, indices, strict=True)
    ]


def _check(sweep: Sweep) -> None:
    trials = sweep.experiment.trials
    if not 0 <= sweep.trial < len(trials):
        raise InputError.value("--trial, or N of trials.N", sweep.trial, f"0 to {len(trials) - 1}")
    if trials[sweep.trial].waveform == "recorded":
        raise InputError(
            f"--trial {sweep.trial}: the drive is a recording, which has no strides; allowed are "
            "square, sine and trapezoid waves"
        )
    if not 0 <= sweep.transient < sweep.strides:
        raise InputError.value("--transient", sweep.transient, f"0 to {sweep.strides - 1} strides")
    if sweep.steps_per_stride < 2 * POSES or sweep.steps_per_stride % POSES:
        allowed = f"a multiple of {POSES} from {2 * POSES}"
        raise InputError.value("--steps-per-stride", sweep.steps_per_stride, allowed)
    if len({axis.field for axis in sweep.axes}) < len(sweep.axes):
        raise InputError.value("--field2", sweep.axes[1].field, "a field other than --field")
    for axis in sweep.axes:
        if axis.field.startswith("trials.") and axis.field.endswith(".duration"):
            raise InputError(
                f"--field {axis.field}: a sweep ignores the duration; --strides sets the number "
                "of strides, and --transient the number of strides that the means exclude"
            )


def _case(sweep: Sweep, point: tuple[float, ...]) -> tuple[Plan, BatchRobot]:
    """Returns the settings and the robot of a point."""
    pairs = zip((axis.field for axis in sweep.axes), point, strict=True)
    values = {field: _whole(field, value) for field, value in pairs}
    experiment = sweep.experiment.with_values(values, "sweep")
    f, steps = experiment.trials[sweep.trial].frequency, sweep.steps_per_stride
    assert f is not None
    if "numerics.step" in values:
        steps = POSES * max(2, int(np.ceil(1.0 / (f * values["numerics.step"] * POSES) - 1e-9)))
    # The given robot sets the number of cells, so that robots of all lengths share a program.
    meshed = experiment.model_copy(update={"robot": sweep.experiment.robot})
    plan = Plan(steps, sweep.strides, *to_numerics(meshed), meshed.channels)
    model = to_model(experiment, sweep.trial)
    return plan, BatchRobot(to_swimmer(model) if sweep.swim else model, jnp.asarray(f, float))


def _whole(field: str, value: float) -> float | int:
    """Returns `value`, converted to an integer if the field is an integer."""
    _, info = field_at(Experiment, field.split("."))
    if info is None or info.annotation is not int:
        return value
    if not value.is_integer():
        advice = "choose another --count"
        raise InputError.value(f"--field {field}", f"{value:g}", "whole numbers", advice)
    return int(value)


class Chunk(NamedTuple):
    """Robots of a group that are simulated in one call, and the file of their results."""

    group: int
    members: np.ndarray
    """Indices of the robots in the group. The last index is repeated until the chunk is full."""
    points: np.ndarray
    """Indices of the points in the sweep, without repetitions."""
    file: Path


def _chunks(groups: list[Group], size: int, partial: Path) -> list[Chunk]:
    found: list[Chunk] = []
    for number, group in enumerate(groups):
        cut = chunks_of(len(group.points), size, workers=1)
        for i in range(cut.total):
            members = cut.indices(i)
            file = partial / f"chunk_{len(found):05d}.json"
            found.append(Chunk(number, members, group.points[members[: cut.distinct(i)]], file))
    return found


def run_sweep(
    sweep: Sweep,
    folder: Path,
    on_begin: Callable[[int, int], None] = lambda strides, done: None,
    on_stride: Callable[[], None] = lambda: None,
) -> dict[str, np.ndarray]:
    """Runs a sweep and returns its table, with one row for each point.

    Finished chunks are files in `folder`/partial, so an interrupted sweep resumes. Chunks that
    another process computes at the same time are not computed here. `on_begin` gets the total and
    the completed number of strides of all chunks. `on_stride` is called after each stride of a
    chunk. Raises `InputError` if `partial` contains other settings.
    """
    groups, partial = groups_of(sweep), folder / "partial"
    chunks = _chunks(groups, _take_up(sweep, partial), partial)
    remaining = [i for i, chunk in enumerate(chunks) if not chunk.file.exists()]
    strides = 1 if sweep.swim else sweep.strides
    on_begin(len(chunks) * strides, (len(chunks) - len(remaining)) * strides)

    def work(number, stopped):
        chunk = chunks[number]
        if not shared.take(chunk.file.name):
            return False
        plan, members, _ = groups[chunk.group]
        batch = take(members, chunk.members)
        if sweep.swim:
            rows = performance_table(*swim_performance(plan, batch))
            on_stride()
        else:
            runs = run_strides(plan, batch, on_stride, stopped)
            rows = steady_quantities(plan, batch, runs, sweep.transient)
        found = {name: x[: len(chunk.points)] for name, x in rows.items()}
        shared.finish(chunk.file.name, json_text(found).encode())
        return True

    with SharedFolder(partial) as shared:
        while remaining:
            workers = min(available_cores(), len(remaining))
            mine = [done for _, done in run_in_threads(work, remaining, workers)]
            remaining = [i for i in remaining if not chunks[i].file.exists()]
            if remaining and not any(mine):
                time.sleep(PAUSE)
        return _gathered(sweep, groups, chunks)


def _gathered(sweep: Sweep, groups: list[Group], chunks: list[Chunk]) -> dict[str, np.ndarray]:
    points = np.asarray(sweep.points)
    table = {axis.column: points[:, number] for number, axis in enumerate(sweep.axes)}
    table["steps_per_stride"] = np.zeros(len(points), int)
    for group in groups:
        table["steps_per_stride"][group.points] = group.plan.steps_per_stride
    for chunk in chunks:
        for name, values in json.loads(chunk.file.read_text()).items():
            column = table.setdefault(name, np.full(len(points), np.nan))
            column[chunk.points] = np.asarray(values, float)
    return table


def _take_up(sweep: Sweep, partial: Path) -> int:
    """Creates the folder `partial`, or checks its settings. Returns the largest chunk size."""
    settings, record = sweep.settings(), partial / "settings.json"
    if record.exists():
        found = json.loads(record.read_text())
        if found["sha256"] != digest(settings):
            differ = [k for k in settings if settings[k] != found["settings"].get(k)]
            raise InputError(
                f"{partial}: this folder holds an unfinished sweep with other settings "
                f"({', '.join(differ)}); finish that sweep, delete the folder, or change --out"
            )
        return int(found["chunk"])
    size = chunks_of(len(sweep.points), LARGEST_CHUNK, available_cores()).size
    partial.mkdir(exist_ok=True)
    content = {"sha256": digest(settings), "chunk": size, "settings": settings}
    if write_first(record, json_text(content).encode()):
        return size
    return _take_up(sweep, partial)  # another process was first
