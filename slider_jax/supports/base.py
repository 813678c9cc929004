"""How the head is held. The tail's end is always free: T = N = M = 0 there."""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
from jaxtyping import Array, Float

from slider_jax.beam.state import Fields


class Start(NamedTuple):
    """Rigid motion of a body at rest in its support."""

    velocity: tuple[Array, Array]
    """Of the head, (x, y) [m/s]."""
    angle: Array
    """[rad]"""
    rate: Array
    """[rad/s]"""


class Support(eqx.Module):
    """Three rows at the head, and the point that they anchor: the head itself, or a pin beside it.

    A support may change from step to step but not within one: the solver asks `during` for the one
    that holds for a step.
    """

    @abstractmethod
    def during(self, t0: Array, t1: Array) -> "Support":
        """The support that holds over the step from `t0` to `t1` [s]."""

    @abstractmethod
    def rows(self, head: Fields, omega: Array, t: Array) -> tuple[Array, Array, Array]:
        """Three residuals that vanish when the support is satisfied.

        `head` holds the six unknowns at the head (scalars), `omega` [rad/s] its turning rate.
        """

    @abstractmethod
    def start(self, t: Array) -> Start:
        """How a straight body moves that is at rest relative to the support at `t` [s]."""

    @abstractmethod
    def sensor_angle(self, phi: Array, t: Array) -> Array:
        """Angle [rad] of the axes of a force sensor in the support, for the head's angle `phi`."""

    @abstractmethod
    def anchor_offset(self, phi: Array, t: Array) -> Float[Array, "2"]:
        """From the head to the anchored point [m], for the head's angle `phi` [rad]."""

    @abstractmethod
    def anchor_velocity(self, head: Fields, omega: Array, t: Array) -> Float[Array, "2"]:
        """Velocity in the plane [m/s] of the anchored point."""
