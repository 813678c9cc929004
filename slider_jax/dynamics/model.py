"""The physical model (robot, effects, pressure law, drive, support and water) and the mesh."""

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


def make_mesh(robot: Robot, numerics: Numerics) -> Mesh:
    """Returns the mesh of `robot`, with its structure and chambers in each cell."""
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
