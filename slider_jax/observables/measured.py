"""Computes the quantities that sensors on the carriage measure: head forces and body position.

The clamp exerts the force T tau + N n on the head and receives the opposite force from the head.
The force sensor is mounted on the carriage. Its axes pitch with the carriage, but they do not turn
with a head that turns in a soft clamp.
"""

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
