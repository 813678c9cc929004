"""Laws by which the pressure of a chamber follows its set pressure."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.actuation.waveform import Segment
from slider_jax.beam.parameters import Scalar


class PressureLaw(eqx.Module):
    """Law by which the pressure in one chamber follows the set pressure."""

    @abstractmethod
    def advance(self, p: Array, set_point: Segment) -> Array:
        """Returns the pressure [Pa] at the end of a segment that starts with pressure `p` [Pa]."""


def _ramp_response(p, a0, a1, span, k):
    """Returns p after `span` [s] of dp/dt = (a - p)/k, where a changes linearly from a0 to a1."""
    lagging = k > 0.0
    x = span / jnp.where(lagging, k, 1.0)
    small = x < 1e-6
    safe = jnp.where(small, 1.0, x)
    mean_decay = jnp.where(small, 1.0 - 0.5 * x, -jnp.expm1(-safe) / safe)
    decay = jnp.exp(-x)
    lagged = decay * p + (1.0 - decay) * a0 + (a1 - a0) * (1.0 - mean_decay)
    return jnp.where(lagging, lagged, a1)


class FirstOrderLag(PressureLaw):
    """The paper's pneumatic lag dp/dt = (p_set - p)/k, integrated exactly.

    Typical values of k are 10 to 300 ms; the paper's rig has 87 ms. At k = 0, the pressure p equals
    p_set and the derivative with respect to k is undefined.
    """

    k: Scalar
    """Time constant [s]."""
    ratios: Float[Array, " chambers"] | None = None
    """Time constant of each chamber, divided by `k`; None for 1."""

    @property
    def time_constants(self) -> Float[Array, " chambers"] | Scalar:
        """Time constant [s] of each chamber, or of all chambers."""
        return self.k if self.ratios is None else self.k * self.ratios

    def advance(self, p, set_point):
        x, k = set_point, self.time_constants
        p = _ramp_response(p, x.a0, x.a1, x.t_break - x.t0, k)
        return _ramp_response(p, x.b0, x.b1, x.t1 - x.t_break, k)


class Ideal(PressureLaw):
    """A law without lag, p = p_set, for trials whose drive is a measured pressure."""

    def advance(self, p, set_point):
        return jnp.broadcast_to(set_point.b1, jnp.shape(p))
