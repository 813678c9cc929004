"""Faults of the chambers that a live stream's pressures are compared with."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar
from slider_jax.effects import Flow


class ChamberFault(Flow):
    """A fault of the chambers' pneumatics on the positive and the negative side, each (2,).

        dp/dt = (1 - shut) (p_set - p)/(slower k) - leak p/k

    where `shut` holds while |p| grows. `leak` is the leak's conductance over the valve's.
    """

    leak: Float[Array, "2"]
    shut: Float[Array, "2"]
    slower: Scalar

    def rate(self, rate, x):
        leak, shut = (jnp.where(x.side > 0.0, y[0], y[1]) for y in (self.leak, self.shut))
        return jnp.where(x.filling, 1.0 - shut, 1.0) * rate / self.slower - leak * x.p / x.k


class Suspect(NamedTuple):
    """A fault that the pressures are compared with, `size` of it on one side or on both (0)."""

    cause: str
    side: int
    size: float

    @property
    def effect(self) -> ChamberFault:
        on = self.size * np.array([self.side > 0, self.side < 0], float)
        leak, shut = (on if self.cause == x else np.zeros(2) for x in ("leak", "blocked valve"))
        slower = self.size if self.cause == "slower lag" else 1.0
        return ChamberFault(jnp.asarray(leak), jnp.asarray(shut), jnp.asarray(slower))


SUSPECTS = (
    *(Suspect("leak", side, size) for side in (1, -1) for size in (0.15, 0.5)),
    *(Suspect("blocked valve", side, size) for side in (1, -1) for size in (0.4, 1.0)),
    Suspect("slower lag", 0, 1.3),
)
