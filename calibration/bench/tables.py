"""Reads bench measurements of a robot in air: a TOML file, and the tables that the file names."""

from pathlib import Path
from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from slider_jax.beam.parameters import Robot
from slider_jax.channels import channels_of
from slider_jax.errors import InputError
from slider_jax.experiment.actuator_tables import ChamberTable
from slider_jax.experiment.robot import robot_of
from slider_jax.experiment.schema import RobotTable, chambers_of, check_robot_actuators
from slider_jax.experiment.tables import FROM_LIST, FileName, Table
from slider_jax.io.csv import read_csv, read_table
from slider_jax.io.toml import read_toml, validate
from slider_jax.io.units import Quantity

MIN_ROWS = 5
"""Smallest number of rows in a table of static shapes."""
MIN_CYCLES, MIN_SAMPLES = 3.0, 10.0
"""Smallest number of periods in a ring-down, and smallest number of samples per period."""
MAX_LOAD = 30.0
"""Largest dimensionless load, load x length^2/EI. A larger load is probably not in newtons."""

Clamp = Literal["head", "joint"]
TipNoise = Annotated[float, Quantity(1e-6, 0.02, "m")] | None


class TipLoadTable(Table):
    """[[tip_load]]: displacement of the tail's end (and the joint) under a lateral force of
    constant direction on the tail's end. With `clamped = "joint"`, the test uses the tail alone."""

    file: FileName
    clamped: Clamp = "head"
    tip_noise: TipNoise = None


class PressureTable(Table):
    """[[pressure]]: displacement of the tail's end under constant chamber pressures."""

    file: FileName
    tip_noise: TipNoise = None


class RingDownTable(Table):
    """[[ring_down]]: displacement of the tail's end after the release of a load at t_s = 0."""

    file: FileName
    tip_noise: TipNoise = None
    air_density: Annotated[float, Quantity(0.0, 2.0, "kg/m^3")] = 1.2


class StaticParameters(Table):
    """[parameters]: the initial value of K_Q."""

    K_Q: Annotated[float, Quantity(1e-9, 1e-4, "m^3")] = 4.79e-7


class StaticsTable(Table):
    """The whole bench file. EI_body, EI_tail, damping_time and K_Q are initial values. A parameter
    keeps its initial value if no table identifies the parameter."""

    name: str
    robot: RobotTable
    parameters: StaticParameters = StaticParameters()
    actuators: Annotated[tuple[ChamberTable, ...], FROM_LIST] = ()
    tip_load: Annotated[tuple[TipLoadTable, ...], FROM_LIST] = ()
    pressure: Annotated[tuple[PressureTable, ...], FROM_LIST] = ()
    ring_down: Annotated[tuple[RingDownTable, ...], FROM_LIST, Field(max_length=1)] = ()

    @property
    def chambers(self) -> tuple[ChamberTable, ...]:
        """The air chambers, from the head to the tail."""
        return chambers_of(self.robot, self.actuators)

    @model_validator(mode="after")
    def _actuators_fit_the_robot(self) -> Self:
        check_robot_actuators(self.robot, self.actuators)
        return self


class Shapes(NamedTuple):
    """Static shapes of one table, one row per load."""

    name: str
    kind: Literal["tip_load", "pressure"]
    on_tail: bool
    """Whether the tail alone was measured, clamped at the joint."""
    force: np.ndarray
    """Lateral force on the tail's end (rows,) [N]."""
    pressure: np.ndarray
    """Pressure (rows, chambers) [Pa] of each chamber."""
    tip: np.ndarray
    """Displacement of the tail's end (rows,) [m]."""
    joint: np.ndarray | None
    """Displacement of the tail's joint (rows,) [m], if measured."""
    noise: float | None
    """Declared standard deviation of the noise of tip and joint [m]; None if not declared."""

    @property
    def measured(self) -> np.ndarray:
        """Returns the tip's displacement [m], followed by the joint's displacement if measured."""
        return self.tip if self.joint is None else np.concatenate([self.tip, self.joint])


class RingDown(NamedTuple):
    """One ring-down with a constant sample rate, its tip noise [m] and air density [kg/m^3]."""

    name: str
    t: np.ndarray
    """Times (n,) since the release [s]."""
    tip: np.ndarray
    """Displacement of the tail's end (n,) [m]."""
    noise: float | None
    air_density: float


class Bench(NamedTuple):
    """All measurements of a bench."""

    table: StaticsTable
    robot: Robot
    shapes: tuple[Shapes, ...]
    ring_down: RingDown | None


def load_bench(path: Path) -> Bench:
    """Returns the content of a bench file and its tables. Raises `InputError` if it is invalid."""
    table = validate(StaticsTable, read_toml(path), str(path))
    folder = path.parent
    robot = robot_of(table.robot, table.parameters.K_Q, folder, table.chambers)
    shapes = [_tip_load(folder, x, table) for x in table.tip_load]
    shapes += [_pressure(folder, x, table) for x in table.pressure]
    ring_down = next((_ring_down(folder, x, table.robot) for x in table.ring_down), None)
    if not shapes and ring_down is None:
        raise InputError(
            f"{path}: no table; add [[tip_load]], [[pressure]] or [[ring_down]] with a file"
        )
    return Bench(table, robot, tuple(shapes), ring_down)


def _tip_load(folder: Path, x: TipLoadTable, table: StaticsTable) -> Shapes:
    path, robot = folder / x.file, table.robot
    columns = read_csv(path, ("force_N", "tip_m"), blank=("joint_m",), increasing="the load")
    force, tip, joint = columns["force_N"], columns["tip_m"], columns.get("joint_m")
    _enough(path, len(force))
    tail = x.clamped == "joint"
    if joint is not None:
        if tail:
            raise InputError(
                f'{path}: column joint_m is not allowed with clamped = "joint"; remove the column'
            )
        if not np.isfinite(joint).all():
            raise InputError(f"{path}: column joint_m has blank cells; fill or remove the column")
        _displacement(path, "joint_m", joint, robot.body_length)
    length = robot.tail_length if tail else robot.tail_length + robot.body_length
    _displacement(path, "tip_m", tip, length)
    stiffness = robot.EI_tail if tail else robot.EI_body
    size = float(np.abs(force).max()) * length**2 / stiffness
    if size > MAX_LOAD:
        raise InputError.value(
            f"{path}, column force_N",
            f"up to {np.abs(force).max():g}",
            f"loads up to {MAX_LOAD * stiffness / length**2:.3g} N for the file's stiffness",
            "forces are in newtons: 1 g weighs 0.00981 N",
        )
    _same_way(path, force, tip, "force_N")
    idle = np.zeros((len(force), len(table.chambers)))
    return Shapes(x.file, "tip_load", tail, force, idle, tip, joint, x.tip_noise)


def _pressure(folder: Path, x: PressureTable, table: StaticsTable) -> Shapes:
    path, robot = folder / x.file, table.robot
    channels = channels_of([x.name for x in table.chambers])
    names = [channels[x].column for x in channels.pressures]
    if not names:
        raise InputError(
            f"{path}: the robot has no chamber; add a table [[actuators]] to the bench file for "
            "each chamber"
        )
    columns = read_table(path, (*names, "tip_m"))
    p = np.stack([columns[x] for x in names], axis=1)
    tip = columns["tip_m"]
    _enough(path, len(tip))
    largest = float(np.abs(p).max())
    if not 1e3 <= largest <= 2e6:
        raise InputError.value(
            f"{path}, columns {' and '.join(names)}",
            f"a peak of {largest:g}",
            "peaks of 1e3 to 2e6 Pa",
            "pressures are in pascal, not kPa or psi",
        )
    steps = np.diff(p, axis=0)
    if not any((steps[:, i] > 0.0).all() or (steps[:, i] < 0.0).all() for i in range(len(names))):
        raise InputError(
            f"{path}: one of the pressures must increase or decrease in all rows; sort the rows by "
            "this pressure, and give loading and unloading as two tables"
        )
    _displacement(path, "tip_m", tip, robot.tail_length + robot.body_length)
    return Shapes(x.file, "pressure", False, np.zeros(len(tip)), p, tip, None, x.tip_noise)


def _ring_down(folder: Path, x: RingDownTable, robot: RobotTable) -> RingDown:
    path = folder / x.file
    columns = read_csv(path, ("t_s", "tip_m"))
    t, tip = columns["t_s"], columns["tip_m"]
    _displacement(path, "tip_m", tip, robot.tail_length + robot.body_length)
    spacing = np.diff(t)
    if np.abs(spacing - np.median(spacing)).max() > 0.05 * np.median(spacing):
        worst = int(np.argmax(np.abs(spacing - np.median(spacing))))
        raise InputError(
            f"{path}: most samples are {np.median(spacing):.4g} s apart, but the sample after "
            f"t_s = {t[worst]:g} follows {spacing[worst]:.4g} s later; cut the record there or "
            "record again"
        )
    if t[0] < 0.0:
        raise InputError.value(f"{path}, column t_s", f"{t[0]:g}", "0 or more", "0 is the release")
    length = robot.tail_length + robot.body_length
    period = 2.0 * np.pi * length**2 / 3.516 * np.sqrt(robot.linear_density / robot.EI_body)
    if t[-1] - t[0] < MIN_CYCLES * 0.5 * period or np.median(spacing) > period / MIN_SAMPLES:
        raise InputError(
            f"{path}: the record has {len(t)} samples in {t[-1] - t[0]:.3g} s; the period is about "
            f"{period:.2g} s. Record {MIN_CYCLES:g} periods or more, with {MIN_SAMPLES:g} samples "
            "or more per period, and give times in seconds"
        )
    return RingDown(x.file, t, tip, x.tip_noise, x.air_density)


def _enough(path: Path, rows: int) -> None:
    if rows < MIN_ROWS:
        raise InputError(f"{path}: {rows} rows under the header; at least {MIN_ROWS} are needed")


def _displacement(path: Path, name: str, values: np.ndarray, length: float) -> None:
    largest = float(np.abs(values).max())
    if not 1e-4 * length <= largest <= length:
        raise InputError.value(
            f"{path}, column {name}",
            f"a peak of {largest:g}",
            f"peaks of {1e-4 * length:.2g} to {length:g} m, the length of the bending part",
            "lengths are in metres",
        )


def _same_way(path: Path, load: np.ndarray, tip: np.ndarray, name: str) -> None:
    slope = float(np.sum((load - load.mean()) * (tip - tip.mean())))
    if slope <= 0.0:
        raise InputError(
            f"{path}: tip_m decreases as {name} increases; use the same positive direction in both "
            "columns"
        )
