"""A mass at the tail's tip."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.beam.spatial import SpatialLoad, no_load
from slider_jax.effects.base import ForceDensity, parameter


class TipMass(ForceDensity):
    """Mass of a camera marker or glue, distributed along the last `length` l of the tail.

        (1 + eps) F_tau = -(mass/l) (dV_tau/dt - omega V_n)
        (1 + eps) F_n   = -(mass/l) (dV_n/dt + omega V_tau)      for s < l

    V is the velocity relative to the tank, omega the turning rate and eps the axial strain. In
    space, the acceleration is dV/dt + omega x V.
    Source: balance of momentum; Blevins, R. D. (1979), Formulas for natural frequency and mode
    shape, ch. 8, on beams that carry masses.
    """

    title = "a mass at the tail's tip"
    order = 490
    segments = ("tail",)
    lacks_weight = True

    mass: Scalar = parameter(
        0.0, 0.0, 5e-3, "kg", "1 g for a plastic marker, more with glue; the tail weighs 50 g"
    )
    """Mass of the marker."""
    length: Scalar = eqx.field(default=0.01)
    """Length l [m] of the part of the tail that carries the mass."""

    def _per_length(self, s, ds, strain):
        covered = jnp.clip((self.length - s) / ds + 0.5, 0.0, 1.0)
        return self.mass / self.length * covered / (1.0 + strain)

    def load_in_space(self, x):
        m = self._per_length(x.structure.s, x.structure.ds, x.strain)
        force = x.V_t.plus(x.omega.cross(x.V)).times(-m)
        return SpatialLoad(force, no_load(x).couple)

    def force(self, x):
        m = self._per_length(x.s, x.ds, x.strain)
        return -m * (x.V_tau_t - x.omega * x.V_n), -m * (x.V_n_t + x.omega * x.V_tau)
