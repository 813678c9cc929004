"""Builds the robot of an experiment from table [robot] and the profiles of its segments."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from slider_jax.beam.parameters import Robot, uniform_robot
from slider_jax.beam.parts import RobotPart
from slider_jax.errors import InputError
from slider_jax.experiment.actuator_tables import ChamberTable
from slider_jax.experiment.schema import (
    PROFILE_COLUMNS,
    RobotTable,
    SegmentedRobotTable,
    SegmentTable,
)
from slider_jax.io.csv import POSITION, read_profile
from slider_jax.io.toml import quantity_in

RIGID_FACTOR = 1e4
"""EI and EA of a rigid segment, divided by the largest EI and EA of the flexible segments."""
RIGID = {"EI": 100.0, "EA": 1e7}
"""Smallest EI [N m^2] and EA [N] of a rigid segment."""
STIFF = 100.0
"""GJ and EI_n [N m^2] of a rigid segment."""
IN_SPACE = ("GJ_body", "GJ_tail", "EI_n_body", "EI_n_tail", "polar_inertia", "width")
"""Keys of a uniform robot that only simulations in three dimensions use."""
Pieces = dict[str, np.ndarray]
"""Lengths (pieces,) and properties (pieces, 2) of a segment."""


def robot_of(
    table: RobotTable | SegmentedRobotTable,
    K_Q: float,
    folder: Path,
    chambers: Sequence[ChamberTable] | None = None,
) -> Robot:
    """Returns the robot of a table [robot]. `folder` contains the profiles of the segments.

    `chambers` are the robot's air chambers (default: those of the table).

    Raises `InputError` if a profile is invalid.
    """
    chambers = table.own_chambers if chambers is None else chambers
    if isinstance(table, RobotTable):
        own = table.model_dump(
            exclude={"water_density", "density", "front_chamber", "rear_chamber", *IN_SPACE}
        )
        robot = uniform_robot(**own, K_Q=K_Q)
        robot = robot.with_parts(
            lambda part: replace(part, polar_inertia=table.polar_inertia, width=table.width)
        )
        robot = replace(
            robot,
            body=replace(robot.body, GJ=table.GJ_body, EI_n=table.EI_n_body),
            tail=replace(robot.tail, GJ=table.GJ_tail, EI_n=table.EI_n_tail),
        )
        if table.density is not None:
            area = table.linear_density / table.density
            robot = robot.with_parts(lambda part: replace(part, area=area))
        return _with_chambers(robot, chambers)
    segments = [_pieces(table, x, folder) for x in table.segments]
    pairs = list(zip(table.segments, segments, strict=True))
    for name, least in RIGID.items():
        flexible = [RIGID_FACTOR * pieces[name].max() for x, pieces in pairs if not x.rigid]
        for x, pieces in pairs:
            if x.rigid:
                pieces[name] = np.full((len(pieces["lengths"]), 2), max([least, *flexible]))
    body = _part([pieces for x, pieces in pairs if x.part == "body"])
    behind = [pieces for x, pieces in pairs if x.part == "tail"]
    masses = table.point_masses
    robot = Robot(
        body,
        _part(behind) if behind else _no_tail(body),
        (),
        K_Q,
        point_masses=jnp.array([[x.s, x.mass] for x in masses]) if masses else None,
    )
    return _with_chambers(robot, chambers)


def _with_chambers(robot: Robot, chambers: Sequence[ChamberTable]) -> Robot:
    ratios, stiffening = [x.K_Q_ratio for x in chambers], [x.stiffening for x in chambers]
    alike = all(x == 1.0 for x in ratios)
    return replace(
        robot,
        chambers=tuple(x.span for x in chambers),
        K_Q_ratios=1.0 if alike else jnp.array(ratios),
        stiffening=jnp.array(stiffening) if any(stiffening) else None,
    )


def _pieces(robot: SegmentedRobotTable, segment: SegmentTable, folder: Path) -> Pieces:
    columns: dict[str, np.ndarray] = {}
    at = np.array([0.0, segment.length])
    if segment.profile is not None:
        columns = _profile(folder / segment.profile, segment)
        at = columns[POSITION]
    found = {"lengths": np.diff(at)}
    for name, column in PROFILE_COLUMNS.items():
        own, common = getattr(segment, name), getattr(robot, name)
        if column in columns and own is not None:
            raise InputError(
                f"{folder / str(segment.profile)}, column {column}: the segment also has "
                f"{name} = {own:g}; remove one of them"
            )
        if column in columns:
            values = columns[column]
        elif segment.rigid and name in RIGID:
            values = np.ones(len(at))
        elif own is None and common is None:
            raise InputError(
                f"{folder / str(segment.profile)}: no column {column}; add this column, or give "
                f"{name} in the segment's table or in [robot]"
            )
        else:
            values = np.full(len(at), common if own is None else own)
        found[name] = np.stack([values[:-1], values[1:]], axis=1)
    if not robot.lacking_in_space:
        found |= _pieces_in_space(robot, segment, found["EI"])
    density = robot.density_of(segment)
    if density is not None:
        found["area"] = found["linear_density"] / density
    return found


def _pieces_in_space(robot: SegmentedRobotTable, segment: SegmentTable, EI: np.ndarray) -> Pieces:
    """Returns the properties that only simulations in three dimensions use; EI_n may be `EI`."""

    def own(name: str) -> float | None:
        value = getattr(segment, name)
        return getattr(robot, name) if value is None else value

    found = {"GJ": own("GJ"), "EI_n": own("EI_n"), "polar_inertia": robot.polar_inertia}
    if segment.rigid:
        found |= {"GJ": STIFF, "EI_n": STIFF}
    if robot.width is not None:
        found["width"] = robot.width
    return {name: EI if x is None else np.full(EI.shape, x) for name, x in found.items()}


def _profile(path: Path, segment: SegmentTable) -> dict[str, np.ndarray]:
    """Returns the columns of a segment's profile, checked for range and length."""
    quantities = {
        column: quantity_in(SegmentTable, name) for name, column in PROFILE_COLUMNS.items()
    }
    return read_profile(path, segment.length, quantities, "segment")


def _part(segments: list[Pieces]) -> RobotPart:
    """Returns the part that consists of `segments`.

    If the part has one uniform segment, its length and properties are numbers. Models of the same
    segments thus have the same tree structure, whatever the values are.
    """
    joined = {name: np.concatenate([x[name] for x in segments]) for name in segments[0]}
    lengths = joined.pop("lengths")
    if len(lengths) == 1 and all((x[0, 0] == x[0, 1]) for x in joined.values()):
        numbers = {name: float(x[0, 0]) for name, x in joined.items()}
        return RobotPart(lengths=float(lengths[0]), **numbers)
    arrays = {name: jnp.asarray(x) for name, x in joined.items()}
    return RobotPart(lengths=jnp.asarray(lengths), **arrays)


def _no_tail(body: RobotPart) -> RobotPart:
    """Returns a tail of zero length, with the properties of the body's far end."""
    ends = {
        name: getattr(body, name)
        for name in (*PROFILE_COLUMNS, "area", "GJ", "EI_n", "polar_inertia", "width")
    }
    last = {k: x if x is None or jnp.ndim(x) == 0 else x[-1, 1] for k, x in ends.items()}
    return RobotPart(lengths=0.0, **last)
