"""Bounds of parameters as invertible transforms to the whole line."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from calibration.model.extended import Parameter


class Bounds(NamedTuple):
    """theta = low + (high - low)/(1 + exp(-z)), entry by entry; a logit of what is known."""

    low: Float[Array, " parameters"]
    high: Float[Array, " parameters"]

    @classmethod
    def of(cls, entries: Sequence[Parameter]) -> "Bounds":
        """The prior ranges. A null at an end is let pass by a twentieth of the range, so that an
        effect that is absent is found at its null and not beside it."""
        low, high = [], []
        for p in entries:
            slack = 0.05 * (p.prior.high - p.prior.low) if p.effect else 0.0
            low.append(p.prior.low - (slack if p.prior.null == p.prior.low else 0.0))
            high.append(p.prior.high + (slack if p.prior.null == p.prior.high else 0.0))
        return cls(jnp.asarray(low), jnp.asarray(high))

    def inside(self, z):
        """theta of z."""
        return self.low + (self.high - self.low) / (1.0 + jnp.exp(-z))

    def outside(self, theta):
        """z of a theta within the bounds, kept off them by a millionth of the range."""
        share = jnp.clip((theta - self.low) / (self.high - self.low), 1e-6, 1.0 - 1e-6)
        return jnp.log(share / (1.0 - share))
