"""Dry friction inside the body."""

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter, shape_parameter

FRICTION_CREEP = 1.0
"""w [1/(m s)], width of the smoothing of |d(kappa)/dt|: 1 % of the rate in a typical stride."""


def dahl_state(memory: Array, kappa_t: Array, dt: Array, kappa_c: Scalar) -> Array:
    """Returns the state q of `InternalFriction` after a stage; `memory` is the state before."""
    speed = jnp.sqrt(kappa_t**2 + FRICTION_CREEP**2)
    return (memory + dt * kappa_t / kappa_c) / (1.0 + dt * speed / kappa_c)


class InternalFriction(BendingMoment):
    """Friction between tubes, sleeve and chambers of the actuated body, in Dahl's model.

        M = EI kappa + z_c q,    kappa_c dq/dt = d(kappa)/dt - |d(kappa)/dt| q

    The state q changes from -1 to 1 while the curvature changes by a few kappa_c. |d(kappa)/dt| is
    smoothed below w = 1 1/(m s), so the friction decays slowly while the body is at rest.
    Source: Dahl, P. R. (1976), Solid friction damping of mechanical vibrations, AIAA J. 14,
    1675-1682.
    """

    title = "dry friction inside the body"
    order = 350
    segments = ("body",)

    z_c: Scalar = parameter(
        0.0, 0.0, 0.03, "N m", "up to a quarter of a chamber's moment, which is 0.12 N m at 250 kPa"
    )
    """z_c, largest friction moment."""
    kappa_c: Scalar = shape_parameter(
        0.3, 0.05, 3.0, "1/m", "a hundredth to all of the curvature in a typical stride, 3 1/m"
    )
    """kappa_c, curvature scale of q."""

    def moment(self, x, memory, dt):
        q = dahl_state(memory, x.kappa_t, dt, self.kappa_c)
        return (1.0 - x.in_tail) * self.z_c * q, q
