"""Computes the quantities that sensors on the carriage measure: head forces and body position.

The clamp exerts the force T tau + N n on the head and receives the opposite force from the head.
The force sensor is mounted on the carriage. Its axes pitch with the carriage, but they do not turn
with a head that turns in a soft clamp.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.state import fields, node_positions, to_plane
from slider_jax.dynamics.step import Snapshot


def midline(x: Snapshot) -> Float[Array, "2 nodes"]:
    """Returns the positions (x, y) [m] of the nodes, tail first."""
    return node_positions(x.y[5], x.memory.strain, x.head, x.mesh.grid)


def lateral(x: Snapshot) -> Float[Array, " nodes"]:
    """Returns the lateral positions y [m] of the nodes relative to the head, tail first.

    A camera on the carriage measures these positions.
    """
    y = midline(x)[1]
    return y - y[-1]


def point(x: Snapshot, place: float) -> Float[Array, "2"]:
    """Returns the position (x, y) [m] of the body at the distance `place` [m] from the head.

    Between two nodes, the position is a cubic polynomial that has the direction of the body at
    both nodes.
    """
    s, line, phi = x.mesh.grid.s, midline(x), x.y[5]
    at = s[-1] - place
    i = jnp.clip(jnp.searchsorted(s, at, side="right") - 1, 0, s.shape[0] - 2)
    stretched = (1.0 + x.memory.strain[i]) * (s[i + 1] - s[i])
    u = (at - s[i]) / (s[i + 1] - s[i])
    begin, end = (stretched * jnp.stack([jnp.cos(phi[j]), jnp.sin(phi[j])]) for j in (i, i + 1))
    return (
        (1.0 + 2.0 * u) * (1.0 - u) ** 2 * line[:, i]
        + u * (1.0 - u) ** 2 * begin
        + u**2 * (3.0 - 2.0 * u) * line[:, i + 1]
        - u**2 * (1.0 - u) * end
    )


def lateral_at(x: Snapshot, place: float) -> Float[Array, ""]:
    """Returns y [m] at the distance `place` [m] from the head, relative to the head."""
    return point(x, place)[1] - x.head[1]


def angle_at(x: Snapshot, place: float) -> Float[Array, ""]:
    """Returns the angle [rad] of the body at the distance `place` [m] from the head."""
    s = x.mesh.grid.s
    return jnp.interp(s[-1] - place, s, x.y[5])


def turning_rate_at(x: Snapshot, place: float) -> Float[Array, ""]:
    """Returns the turning rate [rad/s] of the body at the distance `place` [m] from the head."""
    s = x.mesh.grid.s
    return jnp.interp(s[-1] - place, x.mesh.grid.mid(s), x.section().omega)


def curvature_at(x: Snapshot, place: float) -> Float[Array, ""]:
    """Returns the curvature [1/m] of the body at the distance `place` [m] from the head."""
    s = x.mesh.grid.s
    return jnp.interp(s[-1] - place, x.mesh.grid.mid(s), x.section().kappa)


def yaw_moment(x: Snapshot) -> Float[Array, ""]:
    """Returns the body's moment [N m] on the carriage, counter-clockwise from above."""
    return -fields(x.y[:, -1]).M


def forward_speed(x: Snapshot) -> Float[Array, ""]:
    """Returns the speed [m/s] of the head in the tank, along the head's axis."""
    return fields(x.y[:, -1]).V_tau


def tip(x: Snapshot) -> Float[Array, ""]:
    """Returns the lateral position [m] of the tail tip relative to the head."""
    return lateral(x)[0]


def _on_sensor(x: Snapshot) -> tuple[Array, Array]:
    head = fields(x.y[:, -1])
    turned = head.phi - x.stage.support.sensor_angle(head.phi, x.t)
    return to_plane(-head.T, -head.N, turned)


def thrust(x: Snapshot) -> Float[Array, ""]:
    """Returns the body's forward force [N] on the carriage (-T for a rigid clamp).

    The axes of the forces pitch with the carriage, like the axes of the force sensor.
    """
    return _on_sensor(x)[0]


def recoil(x: Snapshot) -> Float[Array, ""]:
    """Returns the body's force [N] to the left on the carriage; see `thrust` for the axes."""
    return _on_sensor(x)[1]
