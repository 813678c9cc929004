"""Computes the quantities that sensors on the carriage measure: head forces and body position.

The clamp exerts the force T tau + N n on the head and receives the opposite force from the head.
The force sensor is mounted on the carriage. Its axes pitch with the carriage, but they do not turn
with a head that turns in a soft clamp.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.dynamics.step import Snapshot
from slider_jax.spatial.step import SpatialSnapshot

AnySnapshot = Snapshot | SpatialSnapshot
"""A robot in the plane or in space; a sensor sees both alike. A camera looks down along z."""


def midline(x: AnySnapshot) -> Float[Array, "2 nodes"]:
    """Returns the positions (x, y) [m] of the nodes, tail first."""
    return x.positions()[:2]


def lateral(x: AnySnapshot) -> Float[Array, " nodes"]:
    """Returns the lateral positions y [m] of the nodes relative to the head, tail first.

    A camera on the carriage measures these positions.
    """
    y = midline(x)[1]
    return y - y[-1]


def point(x: AnySnapshot, place: float) -> Float[Array, " axes"]:
    """Returns the position [m] of the body at the distance `place` [m] from the head.

    The axes are x and y, and also z for a robot in three dimensions.
    Between two nodes, the position is a cubic polynomial that has the direction of the body at
    both nodes.
    """
    s, line, tau = x.mesh.grid.s, x.positions(), x.directions()
    at = s[-1] - place
    i = jnp.clip(jnp.searchsorted(s, at, side="right") - 1, 0, s.shape[0] - 2)
    stretched = (1.0 + x.memory.strain[i]) * (s[i + 1] - s[i])
    u = (at - s[i]) / (s[i + 1] - s[i])
    begin, end = (stretched * tau[:, j] for j in (i, i + 1))
    return (
        (1.0 + 2.0 * u) * (1.0 - u) ** 2 * line[:, i]
        + u * (1.0 - u) ** 2 * begin
        + u**2 * (3.0 - 2.0 * u) * line[:, i + 1]
        - u**2 * (1.0 - u) * end
    )


def lateral_at(x: AnySnapshot, place: float) -> Float[Array, ""]:
    """Returns y [m] at the distance `place` [m] from the head, relative to the head."""
    return point(x, place)[1] - x.head[1]


def angle_at(x: AnySnapshot, place: float) -> Float[Array, ""]:
    """Returns the angle [rad] of the body at the distance `place` [m] from the head."""
    s = x.mesh.grid.s
    return jnp.interp(s[-1] - place, s, x.headings())


def turning_rate_at(x: AnySnapshot, place: float) -> Float[Array, ""]:
    """Returns the turning rate [rad/s] of the body at the distance `place` [m] from the head."""
    s = x.mesh.grid.s
    return jnp.interp(s[-1] - place, x.mesh.grid.mid(s), x.turning())


def curvature_at(x: AnySnapshot, place: float) -> Float[Array, ""]:
    """Returns the curvature [1/m] of the body at the distance `place` [m] from the head."""
    s = x.mesh.grid.s
    return jnp.interp(s[-1] - place, x.mesh.grid.mid(s), x.bending())


def yaw_moment(x: AnySnapshot) -> Float[Array, ""]:
    """Returns the body's moment [N m] on the carriage, counter-clockwise from above."""
    return -x.yaw_moment()


def forward_speed(x: AnySnapshot) -> Float[Array, ""]:
    """Returns the speed [m/s] of the head in the tank, along the head's axis."""
    return x.speed()


def tip(x: AnySnapshot) -> Float[Array, ""]:
    """Returns the lateral position [m] of the tail tip relative to the head."""
    return lateral(x)[0]


def _on_sensor(x: AnySnapshot) -> tuple[Array, Array]:
    force = x.head_force(x.stage.support.sensor_angle(x.headings()[-1], x.t))
    return -force[0], -force[1]


def thrust(x: AnySnapshot) -> Float[Array, ""]:
    """Returns the body's forward force [N] on the carriage (-T for a rigid clamp).

    The axes of the forces pitch with the carriage, like the axes of the force sensor.
    """
    return _on_sensor(x)[0]


def recoil(x: AnySnapshot) -> Float[Array, ""]:
    """Returns the body's force [N] to the left on the carriage; see `thrust` for the axes."""
    return _on_sensor(x)[1]
