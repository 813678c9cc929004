"""Weight, for climbing in air."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.beam.state import to_body
from slider_jax.effects.base import ForceDensity, parameter


class Gravity(ForceDensity):
    """Weight minus buoyancy per length, along -x. The x axis of a climbing robot points up.

        (F_x, F_y) = (-m g/(1 + eps), 0)

    m is the mass per unstretched length and eps the axial strain. In water, use g (1 - rho A/m),
    with the water's density rho and the cross-section A. Source: Archimedes' principle, Batchelor,
    G. K. (1967), An Introduction to Fluid Dynamics, Cambridge University Press, section 1.4.
    """

    title = "weight"
    order = 400
    segments = ("body", "tail")
    is_candidate = False
    in_air = True

    g: Scalar = parameter(0.0, 0.0, 9.81, "m/s^2", "9.81 in air; almost 0 in water")
    """g, acceleration of gravity, reduced by buoyancy."""

    def force(self, x):
        weight = x.linear_density * self.g / (1.0 + x.strain)
        return to_body((-weight, jnp.zeros_like(weight)), x.phi)
