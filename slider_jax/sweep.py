"""One or two fields of an experiment over ranges: a table that a killed run takes up again."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.batch import available_cores, in_threads, stack, take
from slider_jax.errors import InputError
from slider_jax.experiment import Experiment, to_model, to_numerics
from slider_jax.files import write_json
from slider_jax.provenance import versions
from slider_jax.quantity import Quantity
from slider_jax.striding import POSES, Member, Plan, compile_programs, march, steady

LARGEST_CHUNK = 8


class Axis(NamedTuple):
    """A field of the experiment, such as `trials.0.frequency`, and the values it takes."""

    field: str
    values: tuple[float, ...]

    @classmethod
    def spaced(cls, field: str, start: float, stop: float, count: int) -> "Axis":
        """`count` values evenly from `start` to `stop`."""
        if count < 2:
            raise InputError.value(f"--count of {field}", count, "2 or more values")
        if not np.isfinite([start, stop]).all() or start == stop:
            raise InputError.value(
                f"range of {field}", f"{start} to {stop}", "two different finite numbers"
            )
        return cls(field, tuple(float(x) for x in np.linspace(start, stop, count)))

    @property
    def unit(self) -> str:
        """The field's unit, or nothing."""
        return _unit(self.field)

    @property
    def column(self) -> str:
        """The field's name in a table, with its unit."""
        unit = self.unit.replace(" ", "_").replace("/", "_per_").replace("^", "")
        return f"{self.field}_{unit}" if unit and " of " not in self.unit else self.field


def _unit(field: str) -> str:
    table: Any = Experiment
    for part in field.split("."):
        if part.isdigit():
            continue
        info = getattr(table, "model_fields", {}).get(part)
        if info is None:
            return ""
        inner = getattr(info.annotation, "__args__", (info.annotation,))[0]
        table = inner if hasattr(inner, "model_fields") else info.annotation
        quantities = [x for x in info.metadata if isinstance(x, Quantity)]
        for argument in getattr(info.annotation, "__args__", ()):
            found = getattr(argument, "__metadata__", ())
            quantities += [x for x in found if isinstance(x, Quantity)]
        if quantities:
            return quantities[0].unit
    return ""


class Sweep(NamedTuple):
    """A sweep to run: the experiment, one or two axes, the trial that is run, and how."""

    experiment: Experiment
    axes: tuple[Axis, ...]
    trial: int = 0
    strides: int = 8
    transient: int = 3
    steps_per_stride: int = 300

    @property
    def points(self) -> list[tuple[float, ...]]:
        """Values of the axes for every member; the last axis runs fastest."""
        grids = np.meshgrid(*(axis.values for axis in self.axes), indexing="ij")
        return [tuple(map(float, row)) for row in np.stack([g.ravel() for g in grids], axis=1)]

    def settings(self) -> dict[str, Any]:
        """Everything that the result depends on, in JSON's types."""
        content = {
            "experiment": self.experiment.model_dump(),
            "fields": {axis.field: axis.values for axis in self.axes},
            "trial": self.trial,
            "strides": self.strides,
            "transient": self.transient,
            "steps_per_stride": self.steps_per_stride,
            "versions": versions(),
        }
        return json.loads(json.dumps(content))


def digest(settings: dict[str, Any]) -> str:
    """sha256 of settings."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def members_of(sweep: Sweep) -> Member:
    """The stacked members. Raises `InputError` for a field that cannot be swept."""
    _check(sweep)
    members = [_member(sweep, point) for point in sweep.points]
    shapes = {str(jax.tree.structure(m)) + str(jax.tree.map(np.shape, m)) for m in members}
    if len(shapes) > 1:
        names = ", ".join(axis.field for axis in sweep.axes)
        raise InputError(f"{names}: changes what the model is made of; sweep a number of it")
    batch = stack(members)
    for number, axis in enumerate(sweep.axes):
        ends = [list(sweep.points[0]), list(sweep.points[0])]
        ends[1][number] = axis.values[-1]
        low, high = (jax.tree.leaves(_member(sweep, tuple(point))) for point in ends)
        if all(np.array_equal(a, b) for a, b in zip(low, high, strict=True)):
            raise InputError(
                f"--field {axis.field}: does not change trial {sweep.trial}'s model; allowed are "
                "numbers of robot, parameters, water, effects, and of the trial itself (--trial)"
            )
    return batch


def _check(sweep: Sweep) -> None:
    trials = sweep.experiment.trials
    if not 0 <= sweep.trial < len(trials):
        raise InputError.value("--trial, or N of trials.N", sweep.trial, f"0 to {len(trials) - 1}")
    if trials[sweep.trial].waveform == "recorded":
        raise InputError(
            f"--trial {sweep.trial}: is driven by a recording, which has no strides; allowed are "
            "square, sine and trapezoid waves"
        )
    if not 0 <= sweep.transient < sweep.strides:
        raise InputError.value("--transient", sweep.transient, f"0 to {sweep.strides - 1} strides")
    if sweep.steps_per_stride < 2 * POSES or sweep.steps_per_stride % POSES:
        raise InputError.value(
            "--steps-per-stride", sweep.steps_per_stride, f"a multiple of {POSES} from {2 * POSES}"
        )
    if len({axis.field for axis in sweep.axes}) < len(sweep.axes):
        raise InputError.value("--field2", sweep.axes[1].field, "a field other than --field")


def _member(sweep: Sweep, point: tuple[float, ...]) -> Member:
    values = {axis.field: value for axis, value in zip(sweep.axes, point, strict=True)}
    experiment = sweep.experiment.with_values(values, "sweep")
    trial = experiment.trials[sweep.trial]
    assert trial.frequency is not None
    return Member(to_model(experiment, trial), jnp.asarray(trial.frequency, float))


def run_sweep(
    sweep: Sweep,
    folder: Path,
    on_begin: Callable[[int, int], None] = lambda strides, done: None,
    on_stride: Callable[[], None] = lambda: None,
) -> dict[str, np.ndarray]:
    """Run what `folder`/partial does not hold yet, and return the whole table, a row a member.

    `on_begin(strides, done)`: chunk-strides in all, and those already there; `on_stride()` after
    each new one. Finished chunks are files, so a killed run goes on where it was. Raises
    `InputError` if `partial` was begun with other settings.
    """
    members = members_of(sweep)
    plan = Plan(sweep.steps_per_stride, sweep.strides, *to_numerics(sweep.experiment))
    count, partial = len(sweep.points), folder / "partial"
    size = _take_up(sweep, partial, count)
    chunks = range(-(-count // size))
    left = [chunk for chunk in chunks if not _chunk_file(partial, chunk).exists()]
    indices = [np.minimum(np.arange(c * size, (c + 1) * size), count - 1) for c in chunks]
    if left:
        programs = compile_programs(plan, take(members, indices[0]))
    on_begin(len(chunks) * sweep.strides, (len(chunks) - len(left)) * sweep.strides)

    def work(chunk, stopped):
        batch = take(members, indices[chunk])
        runs = march(plan, programs, batch, on_stride, stopped)
        rows = steady(plan, batch, runs, sweep.transient)
        real = min(size, count - chunk * size)
        write_json(_chunk_file(partial, chunk), {name: x[:real] for name, x in rows.items()})

    for _ in in_threads(work, left, min(available_cores(), max(1, len(left)))):
        pass
    parts = [json.loads(_chunk_file(partial, chunk).read_text()) for chunk in chunks]
    points = np.asarray(sweep.points)
    table = {axis.column: points[:, number] for number, axis in enumerate(sweep.axes)}
    for name in parts[0]:
        table[name] = np.asarray([x for part in parts for x in part[name]], float)
    return table


def _chunk_file(partial: Path, chunk: int) -> Path:
    return partial / f"chunk_{chunk:05d}.json"


def _take_up(sweep: Sweep, partial: Path, count: int) -> int:
    """Begin `partial`, or check that it is of this sweep. Returns the size of its chunks."""
    settings, record = sweep.settings(), partial / "settings.json"
    if record.exists():
        found = json.loads(record.read_text())
        if found["sha256"] != digest(settings):
            differ = [k for k in settings if settings[k] != found["settings"].get(k)]
            raise InputError(
                f"{partial}: holds an unfinished sweep with other settings ({', '.join(differ)}); "
                "finish it with those, delete that folder, or give another --out"
            )
        return int(found["chunk"])
    rounds = -(-count // (LARGEST_CHUNK * available_cores()))
    size = min(LARGEST_CHUNK, -(-count // (rounds * available_cores())))
    partial.mkdir(exist_ok=True)
    write_json(record, {"sha256": digest(settings), "chunk": size, "settings": settings})
    return size
