"""Compressible flow through the open valve."""

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter, shape_parameter
from slider_jax.effects.pneumatics.chamber_expansion import ATMOSPHERE


def characteristic(ratio: Array, b: Scalar) -> Array:
    """Returns psi(r), flow divided by choked flow, for r = downstream/upstream pressure.

    psi(r) = sqrt(1 - ((r - b)/(1 - b))^2) for r > b,    1 for r <= b (the critical ratio)
    """
    beyond = jnp.clip((ratio - b) / (1.0 - b), 0.0, 1.0)
    left = 1.0 - beyond**2
    flows = left > 0.0
    return jnp.where(flows, jnp.sqrt(jnp.where(flows, left, 1.0)), 0.0)


class OrificeFlow(Flow):
    """The valve opens in proportion to the error p_set - p, and the gas is compressible.

        dp/dt = (1 - w + w c) (p_set - p)/k
        c = psi((p_a + |p|)/(p_a + p_s))                            filling, supply to chamber
        c = (p_a + |p|)/(p_a + p_s) psi(p_a/(p_a + |p|))            venting, chamber to atmosphere

    psi(r) = sqrt(1 - ((r - b)/(1 - b))^2) for r > b (subsonic flow), and 1 below the critical ratio
    b. c is the flow of the open valve divided by the choked flow from the supply. p_s is the
    supply's gauge pressure, and p_a the atmospheric pressure. Source: ISO 6358-1 (2013), Pneumatic
    fluid power: determination of flow-rate characteristics of components.
    """

    title = "compressible flow through the valves"
    order = 150

    share: Scalar = parameter(
        0.0, 0.0, 1.0, "-", "0 for the linear lag, 1 for an orifice", physical=(0.0, 1.0)
    )
    """w, weight of orifice flow; 1 - w is the weight of the linear lag."""
    supply: Scalar = shape_parameter(
        600e3, 200e3, 1.1e6, "Pa", "gauge pressures of laboratory regulators and compressors"
    )
    """p_s, gauge pressure of the supply."""
    critical: Scalar = shape_parameter(
        0.3, 0.1, 0.6, "-", "0.2 to 0.5 for valves, 0.528 for a nozzle", physical=(0.0, 0.95)
    )
    """b, critical pressure ratio of psi."""

    def rate(self, rate, x):
        inside, supply = ATMOSPHERE + jnp.abs(x.p), ATMOSPHERE + self.supply
        fill = characteristic(inside / supply, self.critical)
        vent = inside / supply * characteristic(ATMOSPHERE / inside, self.critical)
        c = jnp.where(x.filling, fill, vent)
        return (1.0 + self.share * (c - 1.0)) * rate
