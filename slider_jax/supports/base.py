"""Base class of the supports of the head. The tail end is always free: T = N = M = 0."""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float

from slider_jax.beam.spatial import Quaternion, SpatialFields, Vec
from slider_jax.beam.state import Fields


class Start(NamedTuple):
    """Rigid motion of a body that is at rest relative to the support."""

    velocity: tuple[Array, Array]
    """Velocity (x, y) [m/s] of the head."""
    angle: Array
    """Angle [rad] of the body."""
    rate: Array
    """Turning rate [rad/s] of the body."""


class Support(eqx.Module):
    """A support defines three boundary conditions at the head, and a reference point.

    The reference point is the head or a pin. The solver integrates the velocity of this point to
    find the body's position. A support may change between time steps, but not within a time step.
    """

    @abstractmethod
    def during(self, t0: Array, t1: Array) -> "Support":
        """Returns the support for the time step from `t0` to `t1` [s]."""

    def start_state(self) -> Any:
        """Returns the state of the support at the start of a simulation; None without a state."""
        return None

    def begin(self, state: Any, head: Float[Array, "2"], phi: Array, t0: Array, t1: Array) -> Any:
        """Returns the state at the start of the time step from `t0` to `t1` [s].

        `state` is the state after the last step, and `head` (x, y) [m] and `phi` [rad] are the
        place and the angle of the head. A support with a state must override this method.
        """
        return state

    def in_stage(self, state: Any, dt: Array) -> "Support":
        """Returns the support in a stage. Its state q has the rate (q - `state`)/`dt`.

        A support with a state must override this method and solve the equation of q in closed form.
        """
        return self

    def settled(self, head: Fields, omega: Array, t: Array) -> Any:
        """Returns the state after the stage; a support with a state must override this method."""
        return None

    @abstractmethod
    def rows(self, head: Fields, omega: Array, t: Array) -> tuple[Array, Array, Array]:
        """Returns the residuals of the three boundary conditions at `t` [s].

        `head` contains the six unknowns at the head. `omega` [rad/s] is the head's turning rate.
        """

    @abstractmethod
    def start(self, t: Array) -> Start:
        """Returns the motion of a straight body at rest relative to the support at `t` [s]."""

    @abstractmethod
    def sensor_angle(self, phi: Array, t: Array) -> Array:
        """Returns the angle [rad] of the force sensor's axes; `phi` [rad] is the head's angle."""

    @abstractmethod
    def anchor_offset(self, phi: Array, t: Array) -> Float[Array, "2"]:
        """Returns the vector [m] from the head, at angle `phi` [rad], to the reference point."""

    @abstractmethod
    def anchor_velocity(self, head: Fields, omega: Array, t: Array) -> Float[Array, "2"]:
        """Returns the velocity (x, y) [m/s] of the reference point."""

    @abstractmethod
    def rows_in_space(
        self, head: SpatialFields, frame: Quaternion, omega: Vec, t: Array
    ) -> tuple[Array, ...]:
        """Returns the residuals of the six boundary conditions of a robot in space at `t` [s].

        In the plane, they are the conditions of `rows`, and the other velocities are zero.
        """

    @abstractmethod
    def anchor_in_space(self, t: Array) -> Vec:
        """Returns the vector [m] from the head to the reference point, in the head's frame."""
