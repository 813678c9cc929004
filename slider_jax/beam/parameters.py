"""The robot's parameters and the numerical settings, in SI units.

Every physical number is a leaf of a pytree, so a batch can vary it and JAX can differentiate by it.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.grid import Grid, make_grid
from slider_jax.beam.parts import RobotPart, Scalar

G = 9.81
"""Acceleration of gravity [m/s^2]."""


class Robot(eqx.Module):
    """Geometry and structure of the robot.

    | field | unit | meaning |
    |---|---|---|
    | `body` | | actuated part, from the head to the joint of the tail |
    | `tail` | | passive part |
    | `chambers` | m | distances of each chamber's near and far end from the head |
    | `K_Q` | m^3 | bending moment of a chamber per unit pressure |
    | `point_masses` | m, kg | distance from the head and mass of each point mass |
    | `K_Q_ratios` | - | moment per unit pressure of each chamber, divided by `K_Q` |
    | `stiffening` | N m^2/Pa | increase of EI in a chamber's span per unit pressure; None for 0 |
    """

    body: RobotPart
    tail: RobotPart
    chambers: tuple[tuple[Scalar, Scalar], ...]
    K_Q: Scalar
    point_masses: Float[Array, "masses 2"] | None = None
    K_Q_ratios: Float[Array, " chambers"] | Scalar = 1.0
    stiffening: Float[Array, " chambers"] | None = None

    @property
    def length(self) -> Scalar:
        """Total length L [m] of body and tail."""
        return self.body.length + self.tail.length

    @property
    def mass(self) -> Scalar:
        """Mass [kg] of body, tail and point masses."""
        mass = self.body.mass + self.tail.mass
        return mass if self.point_masses is None else mass + jnp.sum(self.point_masses[:, 1])

    def with_tail(self, length: Scalar | None = None, EI: Scalar | None = None) -> "Robot":
        """Returns the robot with another length [m] or stiffness [N m^2] of the tail."""
        return replace(self, tail=self.tail.changed(length, EI))

    def with_parts(self, change: Callable[[RobotPart], RobotPart]) -> "Robot":
        """Returns the robot with `change(part)` for body and tail."""
        return replace(self, body=change(self.body), tail=change(self.tail))


SLIDER: dict[str, Any] = {
    "body_length": 0.298,
    "tail_length": 0.07,
    "linear_density": 0.7,
    "EI_body": 0.038,
    "EI_tail": 0.0058,
    "EA_body": 1.0e5,
    "EA_tail": 1.0e5,
    "damping_time": 2.0e-3,
    "height": 0.03,
    "front_chamber": (0.02, 0.145),
    "rear_chamber": (0.155, 0.28),
    "K_Q": 4.79e-7,
}
"""The robot SLIDER: the keys of table [robot] of an experiment file, and K_Q."""


def uniform_robot(**changes: Any) -> Robot:
    """Returns a robot with a uniform body and a uniform tail: `SLIDER` with `changes`."""
    x = SLIDER | changes
    unknown = x.keys() - SLIDER.keys()
    if unknown:
        raise TypeError(f"uniform_robot: given {', '.join(unknown)}; allowed {', '.join(SLIDER)}")
    body, tail = (
        RobotPart(
            lengths=x[f"{part}_length"],
            linear_density=x["linear_density"],
            EI=x[f"EI_{part}"],
            EA=x[f"EA_{part}"],
            damping_time=x["damping_time"],
            height=x["height"],
        )
        for part in ("body", "tail")
    )
    return Robot(body, tail, (x["front_chamber"], x["rear_chamber"]), x["K_Q"])


class Numerics(eqx.Module):
    """Size of the mesh and tolerance of Newton's method; all fields are static.

    The mesh has N_p = `tail_cells` + `body_cells` + 1 nodes. Newton's method stops when the
    estimated error of a stage, relative to the sizes from `scales_of`, is below `tolerance`.
    The stages of a step share one factorisation of the Jacobian. The steps with it stop at a
    thousandth of `tolerance`. If they do not converge, a stage makes up to `max_newton` further
    factorisations.
    """

    tail_cells: int = eqx.field(static=True, default=10)
    body_cells: int = eqx.field(static=True, default=40)
    tolerance: float = eqx.field(static=True, default=1e-8)
    max_newton: int = eqx.field(static=True, default=12)

    @property
    def nodes(self) -> int:
        """Number of nodes N_p."""
        return self.tail_cells + self.body_cells + 1


def grid_of(robot: Robot, numerics: Numerics) -> Grid:
    """Returns the grid of `robot`."""
    return make_grid(robot.tail.length, robot.body.length, numerics.tail_cells, numerics.body_cells)


def scales_of(robot: Robot) -> Float[Array, "6 1"]:
    """Returns the characteristic size of each nodal unknown, for the convergence test.

    Forces: EI/L^2. Moment: EI/L. Speeds: sqrt(EI/m)/L with the mass per length m. Angle: 1 rad.
    """
    L, EI = robot.length, robot.body.effective_EI
    force = EI / L**2
    speed = jnp.sqrt(EI * robot.body.length / robot.body.mass) / L
    values = [jnp.asarray(x, float) for x in (force, force, EI / L, speed, speed, 1.0)]
    return jnp.stack(values)[:, None]
