"""Forces at the head: what a sensor between robot and carriage reads.

The body is cut at the head, so the clamp puts T tau + N n on the body and the body the opposite on
the clamp. The sensor
sits on the carriage: its axes pitch with that, but not with a head that turns in a soft clamp.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.frame import to_plane
from slider_jax.beam.state import fields
from slider_jax.dynamics.step import Snapshot


def _on_sensor(x: Snapshot) -> tuple[Array, Array]:
    head = fields(x.y[:, -1])
    turned = head.phi - x.stage.support.sensor_angle(head.phi, x.t)
    return to_plane(-head.T, -head.N, turned)


def thrust(x: Snapshot) -> Float[Array, ""]:
    """Push on the carriage [N], positive forward: -T at the head where the clamp is rigid.

    Axes turn with the carriage, as those of a sensor mounted on it; `carriage_force` does not turn.
    """
    return _on_sensor(x)[0]


def recoil(x: Snapshot) -> Float[Array, ""]:
    """Push on the carriage [N] to the left: -N at the head where the clamp is rigid; axes as
    `thrust`."""
    return _on_sensor(x)[1]


def carriage_force(x: Snapshot) -> Float[Array, "2"]:
    """Force (x, y) [N] of the body on the carriage, in axes fixed to the tank."""
    head = fields(x.y[:, -1])
    return jnp.stack(to_plane(-head.T, -head.N, head.phi))
