"""The duty that the firmware sets, and the base class of two valves that follow it at once."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Chamber, Flow

FULL_DUTY_ERROR = 25 * 932.8
"""Smallest pressure error [Pa] that causes the largest duty of 250. The error is 25 codes, because
the duty is 10 per code. A code is one step of the pressure converter, 932.8 Pa."""
MAX_DUTY = 250.0 / 255.0
"""Largest duty that the firmware sets, as a fraction of full duty (255)."""


def duty(error: Array) -> Array:
    """Returns the duty that the firmware sets at a pressure error [Pa], as a fraction of 255.

    The duty is min(250, 10 |error in codes|)/255. Source: the public repository
    bvanstratum/SoftSnakePressureControl.
    """
    return MAX_DUTY * jnp.minimum(jnp.abs(error) / FULL_DUTY_ERROR, 1.0)


def opening(error: Array, dead: Scalar) -> Array:
    """Returns the flow of a valve at a pressure error [Pa], as a fraction of the full flow.

    The valve stays closed at a duty below `dead`. Above, the flow is linear in the duty.
    """
    return jnp.maximum(duty(error) - dead, 0.0) / (1.0 - dead)


class ValvePair(Flow):
    """A fill valve and a vent valve, pulsed by the firmware, replace the first-order lag.

    At `fill` = 0, which is the null, the lag is unchanged.
    """

    replaces_law = "lag"

    fill: eqx.AbstractVar[Scalar]
    dead: eqx.AbstractVar[Scalar]

    @abstractmethod
    def flows(self, p: Array) -> tuple[Array, Array]:
        """Returns |dp/dt| [Pa/s] of the open fill and vent valves at the pressure p >= 0 [Pa]."""

    def rate(self, rate: Array, x: Chamber) -> Array:
        fill, vent = self.flows(jnp.abs(x.p))
        e = x.p_set - x.p
        valves = jnp.sign(e) * opening(e, self.dead) * jnp.where(x.filling, fill, vent)
        return jnp.where(self.replaces(), valves, rate)

    def replaces(self) -> Array | bool:
        return self.fill > 0.0
