"""Forces at the head: what a sensor between robot and clamp reads.

The body is cut at the head, so the clamp puts T tau + N n on the body and the body the opposite on
the clamp (DESIGN: "a force sensor at a clamp reads the force the robot puts on it").
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.frame import to_plane
from slider_jax.state import fields
from slider_jax.step import Snapshot


def thrust(x: Snapshot) -> Float[Array, ""]:
    """-T at the head [N]: the push on the clamp along tau, positive forward.

    Axes turn with the clamp, as those of a sensor mounted on it; `carriage_force` does not turn.
    """
    return -fields(x.y[:, -1]).T


def recoil(x: Snapshot) -> Float[Array, ""]:
    """-N at the head [N]: the push on the clamp along n, positive to the left, axes as `thrust`."""
    return -fields(x.y[:, -1]).N


def carriage_force(x: Snapshot) -> Float[Array, "2"]:
    """Force (x, y) [N] of the body on the carriage, in axes fixed to the tank.

    Equal to (thrust, recoil) while the clamp's angle is zero, else that turned by it.
    """
    return jnp.stack(to_plane(thrust(x), recoil(x), x.y[5, -1]))
