"""Base class of velocity fields of the water."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.equations import LocalWater


class WaterField(eqx.Module):
    """Velocity of the water as a function of place and time: `Model(..., water=field)`.

    A subclass defines `velocity` for one place. JAX differentiates this function, and its slopes
    should be continuous. At t = 0, the head of the robot is at (0, 0) and the straight body extends
    along -x. `WaterMotion` effects add a uniform velocity. The body does not change the field.
    `ReactiveForce` states which forces of nonuniform water are included.
    """

    @abstractmethod
    def velocity(self, place: Float[Array, "2"], t: Array) -> Float[Array, "2"]:
        """Returns the velocity (U_x, U_y) [m/s] at `place` (x, y) [m] and time `t` [s]."""

    def at_cells(
        self, place: Float[Array, "2 cells"], t: Array, uniform: Float[Array, "2 2"]
    ) -> LocalWater:
        """Returns the water at the places of the cells at `t` [s].

        `uniform` contains a uniform velocity [m/s] and acceleration [m/s^2], which are added.
        """

        def one(x, y):
            def with_value(point):
                U = self.velocity(point[:2], point[2])
                given = getattr(U, "shape", type(U).__name__)
                if given != (2,):
                    raise ValueError(
                        f"{type(self).__name__}.velocity: given {given}; allowed an array of shape "
                        "(2,); write the function for one place"
                    )
                return U, U

            return jax.jacfwd(with_value, has_aux=True)(jnp.stack([x, y, t]))

        slopes, U = jax.vmap(one, out_axes=-1)(*place)
        return LocalWater(
            velocity=U + uniform[0][:, None],
            rate=slopes[:, 2] + uniform[1][:, None],
            gradient=slopes[:, :2],
        )
