"""The physical model (robot, effects, pressure law, drive, support and water) and the mesh."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.actuation import Actuator, PressureLaw, Waveform, chamber_windows
from slider_jax.beam.equations import Structure
from slider_jax.beam.grid import Grid
from slider_jax.beam.parameters import Numerics, Robot, Scalar, grid_of
from slider_jax.effects import BodyChange, Effect, WaterMotion, of_place
from slider_jax.supports import Support


class Drive(eqx.Module):
    """Waveforms of the two chambers' set pressures, and the initial chamber pressures [Pa]."""

    front: Waveform
    rear: Waveform
    start_front: Scalar = 0.0
    start_rear: Scalar = 0.0


class Model(eqx.Module):
    """All physical properties of a simulation; the effects add terms to the equations of motion.

    `robot` has the measured parameters. `body` has the parameters after all `BodyChange` effects.
    """

    robot: Robot
    effects: tuple[Effect, ...]
    pressure_law: PressureLaw
    drive: Drive
    support: Support
    water: Float[Array, "2"] | tuple[Scalar, Scalar] = (0.0, 0.0)
    """Steady uniform velocity (U_x, U_y) [m/s] of the water."""
    actuators: tuple[Actuator, ...] = ()
    """Actuators in addition to the chambers."""

    @property
    def body(self) -> Robot:
        """The robot after all `BodyChange` effects."""
        robot = self.robot
        for effect in of_place(self.effects, BodyChange):
            robot = effect.change(robot)
        return robot

    def water_velocity(self, t: Array) -> Float[Array, "2"]:
        """Returns the water's velocity (2,) [m/s] at `t` [s], including `WaterMotion` effects."""
        velocity = jnp.stack([jnp.asarray(u, float) for u in self.water])
        for effect in of_place(self.effects, WaterMotion):
            velocity = velocity + jnp.stack(effect.velocity(t))
        return velocity


class Mesh(eqx.Module):
    """The robot's grid, and properties of structure and chambers in each cell."""

    grid: Grid
    structure: Structure
    chambers: Float[Array, "2 cells"]
    """Moment in each cell per unit pressure in each chamber [m^3]."""
    windows: Float[Array, "2 cells"]
    """Fraction [-] of each chamber's moment K_Q p that acts in each cell."""


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
    )
    windows = chamber_windows(robot, grid)
    return Mesh(grid, structure, robot.K_Q * windows, windows)
