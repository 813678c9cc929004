"""The robot's properties in the cells, for a simulation in three dimensions."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.grid import Grid
from slider_jax.beam.parameters import Numerics, Robot
from slider_jax.beam.spatial import SpatialStructure, Vec
from slider_jax.dynamics.model import Mesh, make_mesh


class SpatialMesh(eqx.Module):
    """The robot's grid, and properties of structure and chambers in each cell."""

    grid: Grid
    structure: SpatialStructure
    chambers: Float[Array, "chambers cells"]
    """Moment in each cell per unit pressure in each chamber [m^3]."""


def spatial_mesh(robot: Robot, numerics: Numerics) -> SpatialMesh:
    """Returns the mesh of `robot`. Raises `ValueError` for a robot without GJ or polar inertia.

    Without inertia about its axis, a body that rolls freely has no equation of motion.
    """
    for name in ("GJ", "polar_inertia"):
        if getattr(robot.body, name) is None or getattr(robot.tail, name) is None:
            raise ValueError(
                f"robot in three dimensions: {name} of body or tail is absent; give {name} of both"
            )
    if (robot.body.width is None) != (robot.tail.width is None):
        raise ValueError("robot in three dimensions: give the width of body and tail, or of none")
    planar = make_mesh(robot, numerics)
    return SpatialMesh(planar.grid, _structure(robot, planar), planar.chambers)


def _structure(robot: Robot, planar: Mesh) -> SpatialStructure:
    grid, s = planar.grid, planar.structure
    zero, joint = jnp.zeros_like(s.EI), grid.tail_cells
    places = robot.tail.length - grid.s[: joint + 1], robot.length - grid.s[joint:]
    parts = tuple(zip((robot.tail, robot.body), places, strict=True))

    def mean(name: str, otherwise: str) -> Array:
        values = []
        for part, at in parts:
            known = name if getattr(part, name) is not None else otherwise
            values.append(part.cell_mean(known, at[1:], at[:-1]))
        return jnp.concatenate(values)

    width, width_s = zero, zero
    if robot.body.width is not None:
        ends = [part.at_nodes("width", at) for part, at in parts]
        width = mean("width", "")
        width_s = grid.slope(jnp.concatenate([ends[0][:-1], ends[1]]))
    return SpatialStructure(
        linear_density=s.linear_density,
        inertia=Vec(mean("polar_inertia", ""), zero, zero),
        stiffness=Vec(mean("GJ", ""), mean("EI_n", "EI"), s.EI),
        EA=s.EA,
        damping_time=s.damping_time,
        height=s.height,
        height_s=s.height_s,
        width=width,
        width_s=width_s,
        s=s.s,
        ds=s.ds,
        in_tail=s.in_tail,
        joint=s.joint,
        area=s.area,
    )
