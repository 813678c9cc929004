"""A model: the robot, what acts on it, how it is driven and held."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.actuation import PressureLaw, Waveform, chamber_windows
from slider_jax.beam.equations import Structure
from slider_jax.beam.grid import Grid
from slider_jax.beam.parameters import Numerics, Robot, Scalar, grid_of
from slider_jax.effects import BodyChange, Effect, WaterMotion, of_place
from slider_jax.supports import Support


class Drive(eqx.Module):
    """Set pressures of the two chambers, and the pressures [Pa] that they start from."""

    front: Waveform
    rear: Waveform
    start_front: Scalar = 0.0
    start_rear: Scalar = 0.0


class Model(eqx.Module):
    """Everything physical. The equations of motion are the sum of what is listed here.

    `robot` is the body as it was measured; `body` what the effects make of it.
    """

    robot: Robot
    effects: tuple[Effect, ...]
    pressure_law: PressureLaw
    drive: Drive
    support: Support
    water: Float[Array, "2"] | tuple[Scalar, Scalar] = (0.0, 0.0)
    """Steady uniform velocity (U_x, U_y) [m/s] of the water."""

    @property
    def body(self) -> Robot:
        """The robot with the effects that change it."""
        robot = self.robot
        for effect in of_place(self.effects, BodyChange):
            robot = effect.change(robot)
        return robot

    def water_velocity(self, t: Array) -> Float[Array, "2"]:
        """Velocity (U_x, U_y) [m/s] of the water at `t` [s]: the steady stream and the effects'."""
        velocity = jnp.stack([jnp.asarray(u, float) for u in self.water])
        for effect in of_place(self.effects, WaterMotion):
            velocity = velocity + jnp.stack(effect.velocity(t))
        return velocity


class Mesh(eqx.Module):
    """A model's robot on its grid."""

    grid: Grid
    structure: Structure
    chambers: Float[Array, "2 cells"]
    """Moment in each cell per unit pressure in each chamber [m^3]."""
    windows: Float[Array, "2 cells"]
    """Share of each chamber in each cell."""


def make_mesh(robot: Robot, numerics: Numerics) -> Mesh:
    """Lay the robot out on its grid."""
    grid = grid_of(robot, numerics)
    one = jnp.ones_like(grid.ds)
    structure = Structure(
        linear_density=robot.linear_density * one,
        EI=grid.per_cell(robot.EI_tail, robot.EI_body),
        EA=grid.per_cell(robot.EA_tail, robot.EA_body),
        damping_time=robot.damping_time * one,
        height=robot.height * one,
        height_s=0.0 * one,
        s=grid.mid(grid.s),
        ds=grid.ds,
        in_tail=grid.per_cell(one, 0.0 * one),
        joint=grid.at_joint(),
    )
    windows = chamber_windows(robot, grid)
    return Mesh(grid, structure, robot.K_Q * windows, windows)
