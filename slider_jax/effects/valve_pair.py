"""Two valves that the firmware pulses: what its laws of flow share."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Chamber, Flow

FULL = 25 * 932.8
"""Error [Pa] from which on the firmware opens a valve as far as it does: 10 a code, at most 250."""
WIDEST = 250.0 / 255.0
"""Duty of a valve that is open as far as the firmware opens it."""


def opening(error: Array, dead: Scalar) -> Array:
    """Share of full flow of the valve that an error [Pa] opens.

    The duty min(250, 10 |error in codes|)/255, of which the share `dead` opens nothing. Source:
    the public repository bvanstratum/SoftSnakePressureControl.
    """
    duty = WIDEST * jnp.minimum(jnp.abs(error) / FULL, 1.0)
    return jnp.maximum(duty - dead, 0.0) / (1.0 - dead)


class ValvePair(Flow):
    """A valve to the supply and one to the room, opened by the duty, take the place of the lag.

    With `fill` = 0, its null, the lag is left as it is.
    """

    sensors = ("pressure", "thrust", "recoil", "tip")
    replaces_law = "lag"

    fill: eqx.AbstractVar[Scalar]
    dead: eqx.AbstractVar[Scalar]

    @abstractmethod
    def flows(self, p: Array) -> tuple[Array, Array]:
        """|dp/dt| [Pa/s] of the open fill and vent valve at the pressure p >= 0 [Pa]."""

    def rate(self, rate: Array, x: Chamber) -> Array:
        fill, vent = self.flows(jnp.abs(x.p))
        e = x.p_set - x.p
        valves = jnp.sign(e) * opening(e, self.dead) * jnp.where(x.filling, fill, vent)
        return jnp.where(self.replaces(), valves, rate)

    def replaces(self) -> Array | bool:
        return self.fill > 0.0
