"""Support of a swimming robot: the head is free."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.beam.spatial import Vec
from slider_jax.beam.state import to_plane
from slider_jax.supports.base import Start, Support


class MovingHead(Support):
    """A head that may move anywhere. The reference point (`anchor_offset`) is the head."""

    def during(self, t0, t1):
        return self

    def sensor_angle(self, phi, t):
        return phi

    def anchor_offset(self, phi, t):
        return jnp.zeros(2)

    def anchor_velocity(self, head, omega, t):
        return jnp.stack(to_plane(head.V_tau, head.V_n, head.phi))


class Free(MovingHead):
    """A head without loads, T = N = M = 0.

    The robot starts straight, at the angle `heading` [rad] to the x axis of the tank, and moves
    forward at `speed` [m/s].
    """

    speed: Scalar = eqx.field(default=0.0)
    heading: Scalar = eqx.field(default=0.0)

    def start(self, t):
        heading = jnp.asarray(self.heading)
        return Start(to_plane(self.speed, 0.0, heading), heading, jnp.zeros(()))

    def rows(self, head, omega, t):
        return head.T, head.N, head.M

    def rows_in_space(self, head, frame, omega, t):
        return *head.T, *head.M

    def anchor_in_space(self, t):
        return Vec(*jnp.zeros(3))
