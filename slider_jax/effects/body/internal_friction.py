"""Dry friction inside the body."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter

CREEP = 1.0
"""w [1/(m s)], a hundredth of the bending rate of a stride."""


class InternalFriction(BendingMoment):
    """Dahl's friction of tubes, sleeve and chambers that rub in the actuated body.

        M = EI kappa + z_c q,    kappa_c dq/dt = d(kappa)/dt - |d(kappa)/dt| q

    q goes from -1 to 1 within a few kappa_c of bending and is the memory. |r| is
    sqrt(r^2 + w^2), smooth and dissipative: the friction creeps away where the body rests.
    Source: Dahl, P. R. (1976), Solid friction damping of mechanical vibrations, AIAA J. 14,
    1675-1682.
    """

    title = "dry friction inside the body"
    order = 350

    z_c: Scalar = parameter(
        0.0, 0.0, 0.03, "N m", "up to a quarter of the chambers' 0.12 N m at 250 kPa"
    )
    """The moment of friction."""
    kappa_c: Scalar = eqx.field(default=0.3)
    """Curvature [1/m] that turns the friction round; a tenth of a stride's."""

    def moment(self, x, memory, dt):
        speed = jnp.sqrt(x.kappa_t**2 + CREEP**2)
        q = (memory + dt * x.kappa_t / self.kappa_c) / (1.0 + dt * speed / self.kappa_c)
        return (1.0 - x.in_tail) * self.z_c * q, q
