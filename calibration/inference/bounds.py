"""Parameter bounds as invertible transforms to the real line."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from calibration.model.extended import Parameter


class Bounds(NamedTuple):
    """Logistic transform theta = low + (high - low)/(1 + exp(-z)) of every parameter."""

    low: Float[Array, " parameters"]
    high: Float[Array, " parameters"]

    @classmethod
    def of(cls, entries: Sequence[Parameter]) -> "Bounds":
        """Return the prior ranges as bounds.

        A range that ends at the effect's null is extended by a twentieth beyond it. Then the fit
        of an absent effect can reach the null, which it would otherwise only approach.
        """
        low, high = [], []
        for p in entries:
            slack = 0.05 * (p.prior.high - p.prior.low) if p.effect else 0.0
            low.append(p.prior.low - (slack if p.prior.null == p.prior.low else 0.0))
            high.append(p.prior.high + (slack if p.prior.null == p.prior.high else 0.0))
        return cls(jnp.asarray(low), jnp.asarray(high))

    def theta_of(self, z):
        """Return the parameters (parameters,) of z (parameters,)."""
        return self.low + (self.high - self.low) / (1.0 + jnp.exp(-z))

    def z_of(self, theta):
        """Return z of theta, after moving theta at least a millionth of the range inwards."""
        share = jnp.clip((theta - self.low) / (self.high - self.low), 1e-6, 1.0 - 1e-6)
        return jnp.log(share / (1.0 - share))
