"""The robot's parameters and the numerical settings, in SI units.

Every physical number is a leaf of a pytree, so a batch can vary it and JAX can differentiate by it.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.grid import Grid, make_grid

Scalar = Float[Array, ""] | float
G = 9.81
"""Acceleration of gravity [m/s^2]."""


class Robot(eqx.Module):
    """Geometry and structure of the robot. Chamber positions are distances from the head.

    | field | unit | meaning |
    |---|---|---|
    | `body_length` | m | length of the actuated body, from the head to the joint of the tail |
    | `tail_length` | m | length of the passive tail |
    | `linear_density` | kg/m | m, mass per length |
    | `EI_body`, `EI_tail` | N m^2 | bending stiffness |
    | `EA_body`, `EA_tail` | N | axial stiffness |
    | `damping_time` | s | alpha: stress = E_el (1 + alpha d/dt) strain, elastic modulus E_el |
    | `height` | m | H, out-of-plane height that determines the forces of the water |
    | `front_chamber`, `rear_chamber` | m | distances of the near and the far end from the head |
    | `K_Q` | m^3 | bending moment of a chamber per unit pressure |
    """

    body_length: Scalar = 0.298
    tail_length: Scalar = 0.07
    linear_density: Scalar = 0.7
    EI_body: Scalar = 0.038
    EI_tail: Scalar = 0.0058
    EA_body: Scalar = 1.0e5
    EA_tail: Scalar = 1.0e5
    damping_time: Scalar = 2.0e-3
    height: Scalar = 0.03
    front_chamber: tuple[Scalar, Scalar] = (0.02, 0.145)
    rear_chamber: tuple[Scalar, Scalar] = (0.155, 0.28)
    K_Q: Scalar = 4.79e-7

    @property
    def length(self) -> Scalar:
        """Total length L [m] of body and tail."""
        return self.body_length + self.tail_length


class Numerics(eqx.Module):
    """Size of the mesh and tolerance of Newton's method; all fields are static.

    The mesh has N_p = `tail_cells` + `body_cells` + 1 nodes. Newton's method stops when the
    estimated error of a stage, relative to the sizes from `scales_of`, is below `tolerance`.
    `max_newton` is the largest number of factorisations of the Jacobian per stage.
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
    return make_grid(robot.tail_length, robot.body_length, numerics.tail_cells, numerics.body_cells)


def scales_of(robot: Robot) -> Float[Array, "6 1"]:
    """Returns the characteristic size of each nodal unknown, for the convergence test.

    Forces: EI/L^2. Moment: EI/L. Speeds: sqrt(EI/m)/L with the mass per length m. Angle: 1 rad.
    """
    L, EI = robot.length, robot.EI_body
    force = EI / L**2
    speed = jnp.sqrt(EI / robot.linear_density) / L
    values = [jnp.asarray(x, float) for x in (force, force, EI / L, speed, speed, 1.0)]
    return jnp.stack(values)[:, None]
