"""The physical model (robot, effects, pressure law, drive, support and water) and the mesh."""

from collections.abc import Callable
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.actuation import Actuator, PressureLaw, Waveform, chamber_windows
from slider_jax.beam.equations import LocalWater, Structure
from slider_jax.beam.grid import Grid
from slider_jax.beam.parameters import Numerics, Robot, Scalar, grid_of
from slider_jax.beam.waterline import Immersion, Waterline
from slider_jax.effects import BodyChange, Effect, WaterMotion, of_place
from slider_jax.errors import InputError
from slider_jax.supports import Support
from slider_jax.water import WaterField


class Drive(eqx.Module):
    """The waveform of each chamber's set pressure, from the head to the tail."""

    waves: tuple[Waveform, ...]
    start: Float[Array, " chambers"] | Scalar = 0.0
    """Initial pressure [Pa] of each chamber, or of all chambers."""


class SpaceSettings(eqx.Module):
    """What a model in three dimensions has in addition to a planar one."""

    angles: Float[Array, " chambers"]
    """Directions [rad] of the chambers around the axis, from n towards b. At 0, a chamber bends the
    body in its plane (tau, n)."""
    roll: Scalar = 0.0
    """Initial roll [rad] of the body about its axis. At 0, b is along z."""
    far_angles: Float[Array, " chambers"] | None = None
    """Directions [rad] at the far ends of helical chambers; `angles` are then those at the near
    ends. None if no chamber is helical."""
    distances: Float[Array, " chambers"] | None = None
    """Distances [m] of the chambers from the axis, which set the twist by their pressures. None if
    all chambers only bend the body."""


class Model(eqx.Module):
    """All physical properties of a simulation; the effects add terms to the equations of motion.

    `robot` has the measured parameters. `body` has the parameters after all `BodyChange` effects.
    """

    robot: Robot
    effects: tuple[Effect, ...]
    pressure_law: PressureLaw
    drive: Drive
    support: Support
    water: Float[Array, "2"] | tuple[Scalar, Scalar] | WaterField | None = None
    """Steady uniform velocity (U_x, U_y) [m/s] of the water, or a nonuniform velocity field, or
    None for still water. A velocity of 0 gives the same motion as None in more computing time. In a
    batch, the water of all models is None, or of none."""
    actuators: tuple[Actuator, ...] = ()
    """Actuators in addition to the chambers."""
    space: SpaceSettings | None = None
    """Settings of a model in three dimensions; None for a planar model."""
    waterline: Waterline | None = None
    """Surface of the water; None if the water is everywhere."""

    def __check_init__(self):
        if self.space is not None and self.waterline is not None:
            raise InputError(
                "waterline: given a surface of the water; allowed nothing with dimension = 3, "
                "because immersion is computed in the plane only"
            )

    @property
    def body(self) -> Robot:
        """The robot after all `BodyChange` effects."""
        robot = self.robot
        for effect in of_place(self.effects, BodyChange):
            robot = effect.change(robot)
        return robot

    def require_plane(self) -> None:
        """Raises `InputError` for a model in three dimensions."""
        if self.space is not None:
            raise InputError(
                "dimension: given 3; allowed 2, because this computation is planar; `slider "
                "simulate` computes in three dimensions"
            )

    def water_velocity(self, t: Array) -> Float[Array, "2"]:
        """Returns the uniform part (2,) [m/s] of the water's velocity at `t` [s].

        It includes `WaterMotion` effects. A `WaterField` has no uniform part.
        """
        velocity = jnp.zeros(2)
        if self.water is not None and not isinstance(self.water, WaterField):
            velocity = jnp.stack([jnp.asarray(u, float) for u in self.water])
        for effect in of_place(self.effects, WaterMotion):
            velocity = velocity + jnp.stack(effect.velocity(t))
        return velocity

    def water_at(
        self, place: Callable[[], Float[Array, "2 cells"]], t: Array
    ) -> Float[Array, "2 2"] | LocalWater | None:
        """Returns velocity and acceleration of uniform water at `t` [s], or the local water.

        The value is None for still water. `place` returns the positions [m] of the cells; it is
        called only for a `WaterField`.
        """
        uniform = self.uniform_water_at(t)
        if uniform is not None and isinstance(self.water, WaterField):
            return self.water.at_cells(place(), t, uniform)
        return uniform

    def uniform_water_at(self, t: Array) -> Float[Array, "2 2"] | None:
        """Returns velocity and acceleration of the water's uniform part; None for still water."""
        if self.water is None and not of_place(self.effects, WaterMotion):
            return None
        return jnp.stack(jax.jvp(self.water_velocity, (t,), (jnp.ones_like(t),)))

    def immersion_at(self, nodes: Callable[[], Float[Array, "2 nodes"]]) -> Immersion | None:
        """Returns the wet part of the cells, or None without a waterline.

        `nodes` returns the positions [m] of the nodes; it is called only for a waterline.
        """
        return None if self.waterline is None else self.waterline.immersion(nodes())


class Mesh(eqx.Module):
    """The robot's grid, and properties of structure and chambers in each cell."""

    grid: Grid
    structure: Structure
    chambers: Float[Array, "chambers cells"]
    """Moment in each cell per unit pressure in each chamber [m^3]."""
    windows: Float[Array, "chambers cells"]
    """Fraction [-] of each chamber's moment K_Q p that acts in each cell."""
    stiffening: Float[Array, "chambers cells"] | None = None
    """Increase of EI in each cell per unit pressure in each chamber [N m^2/Pa]; None for 0."""

    def under(self, pressure: Float[Array, " chambers"]) -> Structure:
        """Returns the structure with EI + sum of stiffening |p|, for the `pressure` p [Pa].

        The sum includes the chambers of both sides, so that EI increases even if their moments
        cancel. Source: Comer, R. L. and Levy, S. (1963), Deflections of an inflated
        circular-cylindrical cantilever beam, AIAA J. 1, 1652-1655.
        """
        if self.stiffening is None:
            return self.structure
        return replace(self.structure, EI=self.structure.EI + jnp.abs(pressure) @ self.stiffening)


def _of_point_masses(robot: Robot, grid: Grid) -> Float[Array, " cells"] | float:
    """Returns the mass per length [kg/m] of the point masses.

    A mass is distributed to the two nearest cells; its moment is exact between their middles.
    """
    if robot.point_masses is None:
        return 0.0
    index = jnp.arange(grid.ds.shape[0], dtype=grid.s.dtype)
    place, mass = robot.point_masses.T
    xi = jnp.interp(robot.length - place, grid.mid(grid.s), index)
    return mass @ jnp.maximum(0.0, 1.0 - jnp.abs(index - xi[:, None])) / grid.ds


def make_mesh(robot: Robot, numerics: Numerics) -> Mesh:
    """Returns the mesh of `robot`, with its structure and chambers in each cell."""
    grid = grid_of(robot, numerics)
    one, joint = jnp.ones_like(grid.ds), grid.tail_cells
    # Distances of the nodes from the near ends of tail and body.
    tail, body = robot.tail.length - grid.s[: joint + 1], robot.length - grid.s[joint:]

    def mean(name: str) -> Array:
        parts = (robot.tail, tail), (robot.body, body)
        return jnp.concatenate([part.cell_mean(name, at[1:], at[:-1]) for part, at in parts])

    height = mean("height")
    at_nodes = [robot.tail.at_nodes("height", tail), robot.body.at_nodes("height", body)]
    at_joint = 0.5 * (at_nodes[0][-1:] + at_nodes[1][:1]) if joint else at_nodes[1][:1]
    squares = jnp.square(jnp.concatenate([at_nodes[0][:-1], at_joint, at_nodes[1][1:]]))
    structure = Structure(
        linear_density=mean("linear_density") + _of_point_masses(robot, grid),
        EI=mean("EI"),
        EA=mean("EA"),
        damping_time=mean("damping_time"),
        height=height,
        # The added mass is proportional to H^2. With this slope of H, the momentum of the water
        # that leaves a cell equals the momentum that enters the next cell.
        height_s=(squares[1:] - squares[:-1]) / (2.0 * height * grid.ds),
        s=grid.mid(grid.s),
        ds=grid.ds,
        in_tail=grid.per_cell(one, 0.0 * one),
        joint=grid.at_joint(),
        area=None if robot.body.area is None else mean("area"),
    )
    windows = chamber_windows(robot, grid)
    K_Q = jnp.broadcast_to(robot.K_Q * robot.K_Q_ratios, windows.shape[:1])
    stiffening = None if robot.stiffening is None else robot.stiffening[:, None] * windows
    return Mesh(grid, structure, K_Q[:, None] * windows, windows, stiffening)
