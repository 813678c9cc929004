"""Builds the robot of an experiment from table [robot] and the profiles of its segments."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from slider_jax.beam.parameters import Robot, uniform_robot
from slider_jax.beam.parts import Property, RobotPart
from slider_jax.errors import InputError
from slider_jax.experiment.schema import (
    PROFILE_COLUMNS,
    RobotTable,
    SegmentedRobotTable,
    SegmentTable,
)
from slider_jax.io.csv import read_csv
from slider_jax.io.toml import quantity_of

RIGID_FACTOR = 1e4
"""EI and EA of a rigid segment, divided by the largest EI and EA of the flexible segments."""
RIGID = {"EI": 100.0, "EA": 1e7}
"""EI [N m^2] and EA [N] of a rigid segment of a robot without flexible segments."""
POSITION = "s_m"
"""Column of a profile: the distance [m] from the segment's near end."""

Pieces = dict[str, np.ndarray]
"""Lengths (pieces,) and properties (pieces, 2) of a segment."""


def robot_of(table: RobotTable | SegmentedRobotTable, K_Q: float, folder: Path) -> Robot:
    """Returns the robot of a table [robot]. `folder` contains the profiles of the segments.

    Raises `InputError` if a profile is invalid.
    """
    if isinstance(table, RobotTable):
        return uniform_robot(**table.model_dump(exclude={"water_density"}), K_Q=K_Q)
    segments = [_pieces(table, x, folder) for x in table.segments]
    for name, otherwise in RIGID.items():
        flexible = [
            p[name].max() for p, x in zip(segments, table.segments, strict=True) if not x.rigid
        ]
        stiff = RIGID_FACTOR * max(flexible) if flexible else otherwise
        for pieces, x in zip(segments, table.segments, strict=True):
            if x.rigid:
                pieces[name] = np.full((len(pieces["lengths"]), 2), stiff)
    body, tail = (
        _part([p for p, x in zip(segments, table.segments, strict=True) if x.part == part])
        for part in ("body", "tail")
    )
    masses = table.point_masses
    assert body is not None
    return Robot(
        body,
        tail or _no_tail(body),
        table.front_chamber,
        table.rear_chamber,
        K_Q,
        point_masses=jnp.array([[x.s, x.mass] for x in masses]) if masses else None,
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
    return found


def _profile(path: Path, segment: SegmentTable) -> dict[str, np.ndarray]:
    """Returns the columns of a segment's profile, checked for range and length."""
    columns = read_csv(path, (POSITION,), tuple(PROFILE_COLUMNS.values()), "the distance")
    at = columns[POSITION]
    if abs(at[0]) > 1e-6 or abs(at[-1] - segment.length) > 1e-6:
        raise InputError(
            f"{path}: {POSITION} covers {at[0]:g} to {at[-1]:g} m; allowed 0 to "
            f"{segment.length:g} m, the length of the segment; correct the profile or the length"
        )
    for name, column in PROFILE_COLUMNS.items():
        if column not in columns:
            continue
        quantity = quantity_of(SegmentTable.model_fields[name])
        assert quantity is not None
        for row, x in enumerate(columns[column], start=2):
            if not quantity.low <= x <= quantity.high:
                raise InputError.value(
                    f"{path}, line {row}, column {column}", f"{x:g}", quantity.allowed,
                    quantity.advice,
                )  # fmt: skip
    return columns


def _part(segments: list[Pieces]) -> RobotPart | None:
    """Returns the part that consists of `segments`. A uniform property is one number."""
    if not segments:
        return None
    joined = {name: np.concatenate([x[name] for x in segments]) for name in segments[0]}

    def simplest(name: str) -> Property:
        values = joined[name]
        return float(values[0, 0]) if (values == values[0, 0]).all() else jnp.asarray(values)

    lengths = joined["lengths"]
    properties = {name: simplest(name) for name in PROFILE_COLUMNS}
    uniform = all(isinstance(x, float) for x in properties.values())
    return RobotPart(
        lengths=float(lengths.sum()) if uniform else jnp.asarray(lengths), **properties
    )


def _no_tail(body: RobotPart) -> RobotPart:
    """Returns a tail of zero length, with the properties of the body's far end."""
    ends = {name: getattr(body, name) for name in PROFILE_COLUMNS}
    return RobotPart(
        lengths=0.0, **{k: x if jnp.ndim(x) == 0 else x[-1, 1] for k, x in ends.items()}
    )
