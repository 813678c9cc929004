"""How the head is held. The tail's end is always free: T = N = M = 0 there."""

from abc import abstractmethod

import equinox as eqx
from jaxtyping import Array, Float

from slider_jax.state import Fields


class Support(eqx.Module):
    """Three rows at the head, and the point of the plane that they anchor."""

    @abstractmethod
    def rows(self, head: Fields, omega: Array, t: Array) -> tuple[Array, Array, Array]:
        """Three residuals that vanish when the support is satisfied.

        `head` holds the six unknowns at the head (scalars), `omega` [rad/s] its turning rate.
        """

    @abstractmethod
    def initial(self) -> tuple[tuple[Array, Array], Array]:
        """Velocity (x, y) [m/s] and angle [rad] of a body that rests in the support at t = 0."""

    @abstractmethod
    def anchor_velocity(self, head: Fields, omega: Array, t: Array) -> Float[Array, "2"]:
        """Velocity in the plane [m/s] of the anchored point."""

    @abstractmethod
    def head_position(self, anchor: Float[Array, "2"], phi: Array, t: Array) -> Float[Array, "2"]:
        """Position [m] of the head from the anchored point and the head's angle."""

    @abstractmethod
    def reanchor(
        self, anchor: Float[Array, "2"], phi: Array, t_before: Array, t: Array
    ) -> Float[Array, "2"]:
        """The anchored point at `t` [s] where the support may have changed since `t_before`."""
