"""Reads the file of a static case and builds the rod and its loads."""

from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from slider_jax.errors import InputError
from slider_jax.io.csv import POSITION, read_profile
from slider_jax.io.toml import quantity_in, read_toml, validate
from slider_jax.rod.ends import HeldEnd, held_end
from slider_jax.rod.loads import RodLoads, RodTendon, covered_share, straight_tendon
from slider_jax.rod.rod import Rod, gauss_points, half_cells
from slider_jax.statics.tables import (
    CURVATURE,
    CURVATURE_COLUMNS,
    PROFILE_COLUMNS,
    EndTable,
    RodChamberTable,
    RodTable,
    StaticCaseTable,
)


class StaticCase(NamedTuple):
    """A rod, its loads and its supports, with the file that describes them."""

    table: StaticCaseTable
    rod: Rod
    loads: RodLoads
    end: HeldEnd | None
    files: tuple[Path, ...]


def load_case(path: Path) -> StaticCase:
    """Returns the static case of a TOML file. Raises `InputError` if a file is invalid."""
    table = validate(StaticCaseTable, read_toml(path), str(path))
    x, load = table.rod, table.load
    profile = path.parent / x.profile if x.profile is not None else None
    columns = _profile(profile, x) if profile is not None else {}
    cells = table.numerics.nodes - 1
    edges = np.linspace(0.0, x.length, cells + 1)
    points = gauss_points(edges)
    given = {name: _along(name, x, columns, points, path) for name in PROFILE_COLUMNS}
    gravity = np.array(load.gravity)
    size = float(np.linalg.norm(gravity))
    density, area = given["linear_density"], given["section_area"]
    if size > 0.0 and density is None:
        raise InputError(
            f"{path}: load.gravity: the weight of the rod is not known; add rod.linear_density"
        )
    if size > 0.0 and load.fluid_density > 0.0 and area is None:
        raise InputError(
            f"{path}: load.fluid_density: the buoyancy is not known; add rod.section_area"
        )
    zero = np.zeros(len(points))
    mass = (zero if density is None else density) - load.fluid_density * (
        zero if area is None else area
    )
    curvature = np.stack(
        [zero if column is None else column for column in _curvature(x, columns, points)]
    )
    rod = Rod(
        ds=jnp.asarray(np.diff(half_cells(edges))),
        stiffness=jnp.stack([jnp.asarray(given[name]) for name in ("GJ", "EI_n", "EI_b")], axis=1),
        initial_curvature=jnp.asarray(curvature.T),
        clamp=jnp.asarray(_frame(x.clamp_tangent, x.clamp_normal)),
        weight=jnp.asarray(size * mass),
        EA=None if given["EA"] is None else jnp.asarray(given["EA"]),
    )
    lines = [
        straight_tendon(each.span, each.start, each.end, each.tension, edges)
        for each in table.tendons
    ]
    lines += [_chamber(chamber, edges) for chamber in table.chambers]
    down = gravity / size if size > 0.0 else np.array([0.0, 0.0, -1.0])
    loads = RodLoads(
        jnp.array(load.force),
        jnp.array(load.moment),
        jnp.asarray(down),
        tuple(lines),
        load.follower,
    )
    end = None if table.end is None else _support(table.end, x, rod, path)
    return StaticCase(table, rod, loads, end, (path, profile) if profile is not None else (path,))


def _frame(tangent, normal) -> np.ndarray:
    """Returns the frame with the columns t, n and b; the vectors may have any length."""
    t, n = (np.array(v) / np.linalg.norm(v) for v in (tangent, normal))
    return np.stack([t, n, np.cross(t, n)], axis=1)


def _support(end: EndTable, x: RodTable, rod: Rod, path: Path) -> HeldEnd:
    """Returns the supports of both ends."""
    place = np.array(end.position)
    away = np.linalg.norm(place - end.sliding @ place)
    if rod.EA is None and away >= x.length:
        raise InputError(
            f"{path}: end.position: given {list(end.position)}; allowed less than {x.length:g} m "
            "from the start, because a rod without EA does not stretch; move the end, let it slide "
            "with end.slides_along, or give EA"
        )
    if away >= 2.0 * x.length:
        raise InputError(
            f"{path}: end.position: given {list(end.position)}; allowed less than 2 x rod.length "
            "from the start; positions are in metres"
        )
    frame = None
    if end.kind == "clamped":
        frame = _frame(end.tangent or x.clamp_tangent, end.normal or x.clamp_normal)
    slides = None if end.slides_along is None else np.array(end.slides_along)
    return held_end(rod, place, frame, end.turns or 0.0, slides, x.start == "hinged")


def _along(name, x: RodTable, columns, points, path: Path) -> np.ndarray | None:
    """Returns a property at the points, or None if it is not given."""
    column, own = PROFILE_COLUMNS[name], getattr(x, name)
    if column in columns and own is not None:
        raise InputError(
            f"{path.parent / str(x.profile)}, column {column}: [rod] also has {name} = {own:g}; "
            "remove one of them"
        )
    if column in columns:
        return np.interp(points, columns[POSITION], columns[column])
    if own is not None:
        return np.full(len(points), own)
    if name in ("EI_n", "EI_b", "GJ"):
        raise InputError(
            f"{path.parent / str(x.profile)}: no column {column}; add this column, or give {name} "
            "in [rod]"
        )
    return None


def _curvature(x: RodTable, columns, points) -> list[np.ndarray | None]:
    """Returns the three components of the initial curvature at the points; None for zero."""
    found: list[np.ndarray | None] = []
    for i, column in enumerate(CURVATURE_COLUMNS):
        if column in columns:
            found.append(np.interp(points, columns[POSITION], columns[column]))
        elif x.initial_curvature is not None:
            found.append(np.full(len(points), x.initial_curvature[i]))
        else:
            found.append(None)
    return found


def _profile(path: Path, x: RodTable) -> dict[str, np.ndarray]:
    """Returns the columns of a rod's profile, checked for range and length."""
    quantities = {column: quantity_in(RodTable, name) for name, column in PROFILE_COLUMNS.items()}
    quantities |= dict.fromkeys(CURVATURE_COLUMNS, CURVATURE)
    columns = read_profile(path, x.length, quantities, "rod")
    if x.initial_curvature is not None and any(name in columns for name in CURVATURE_COLUMNS):
        raise InputError(f"{path}: [rod] also has initial_curvature; remove one of them")
    return columns


def _chamber(x: RodChamberTable, edges) -> RodTendon:
    """Returns the tendon that pushes with the force of the chamber's pressure."""
    rate = (x.angles[1] - x.angles[0]) / (x.span[1] - x.span[0])
    angle = x.angles[0] + rate * (np.clip(gauss_points(edges), *x.span) - x.span[0])
    place = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ahead = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    return RodTendon(
        offset=jnp.asarray(x.distance * place),
        offset_slope=jnp.asarray(rate * x.distance * ahead),
        share=jnp.asarray(covered_share(x.span, edges)),
        tension=jnp.asarray(-x.pressure * x.K_Q / x.distance),
    )
