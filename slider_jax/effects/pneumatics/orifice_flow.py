"""Compressible flow through the open valve."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter
from slider_jax.effects.pneumatics.chamber_expansion import ATMOSPHERE


def characteristic(ratio: Array, b: Scalar) -> Array:
    """Returns flow divided by the choked flow at the ratio r of downstream to upstream pressure.

    psi(r) = sqrt(1 - ((r - b)/(1 - b))^2) for r > b,    1 below
    """
    beyond = jnp.clip((ratio - b) / (1.0 - b), 0.0, 1.0)
    left = 1.0 - beyond**2
    flows = left > 0.0
    return jnp.where(flows, jnp.sqrt(jnp.where(flows, left, 1.0)), 0.0)


class OrificeFlow(Flow):
    """The valve opens in proportion to the error; its flow is that of a compressible gas.

        dp/dt = (1 - w + w c) (p_set - p)/k
        c = psi((p_a + |p|)/(p_a + p_s))                            filling, supply to chamber
        c = (p_a + |p|)/(p_a + p_s) psi(p_a/(p_a + |p|))            venting, chamber to room

    psi(r) = sqrt(1 - ((r - b)/(1 - b))^2) for subsonic flow, and 1 below the critical ratio b. p_s
    is the supply's gauge pressure. Source: ISO 6358-1 (2013), Pneumatic fluid power: determination
    of flow-rate characteristics of components.
    """

    title = "compressible flow through the valves"
    order = 150

    share: Scalar = parameter(0.0, 0.0, 1.0, "-", "from the linear lag to an orifice")
    """w, share of orifice flow."""
    supply: Scalar = eqx.field(default=600e3)
    """p_s [Pa]."""
    critical: Scalar = eqx.field(default=0.3)
    """b [-], between 0.2 and 0.5 for valves."""

    def rate(self, rate, x):
        inside, supply = ATMOSPHERE + jnp.abs(x.p), ATMOSPHERE + self.supply
        fill = characteristic(inside / supply, self.critical)
        vent = inside / supply * characteristic(ATMOSPHERE / inside, self.critical)
        c = jnp.where(x.filling, fill, vent)
        return (1.0 + self.share * (c - 1.0)) * rate
