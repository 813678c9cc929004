"""Base classes of the actuators. An actuator acts on a span of the body, without air pressure.

Positions along the body are distances from the head [m], as for the chambers of `Robot`. The
curvature is kappa = d(phi)/ds, with s towards the head. For a small lateral displacement h(d) [m]
at the distance d from the head, kappa = d^2 h/dd^2.
"""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.equations import Section
from slider_jax.beam.parameters import Scalar


class Actuator(eqx.Module):
    """Acts on the body from `near` to `far`, both distances from the head [m]."""

    near: Scalar
    far: Scalar

    def place(self, s: Float[Array, " cells"], ds: Float[Array, " cells"]) -> tuple[Array, Array]:
        """Returns the distances [m] of the cells from the head, and the share [-] in the span.

        `s` [m] are the distances of the cells' middles from the tail, and `ds` [m] their lengths.
        The share of a cell is the fraction of the cell that is inside the span.
        """
        distance = s[-1] + 0.5 * ds[-1] - s
        begin = jnp.maximum(distance - 0.5 * ds, self.near)
        end = jnp.minimum(distance + 0.5 * ds, self.far)
        return distance, jnp.maximum(end - begin, 0.0) / ds


class Couple(Actuator):
    """An actuator whose moment depends on the time and on the local state of the body."""

    @abstractmethod
    def moment(self, x: Section) -> Float[Array, " cells"]:
        """Returns the active moment M_act [N m] in the cells. M = EI kappa - M_act."""
