"""Weight of the markers and their holders."""

from dataclasses import replace

import jax.numpy as jnp

from calibration.tentacle.arm import MARKER_NODES, ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.beam.parameters import G
from slider_jax.effects.base import parameter


class MarkerMass(AbstractArmEffect):
    """The markers have masses; each acts on the axis, at the last Gauss point before its marker."""

    marker_1: float = parameter(0.0, 0.0, 0.01, "kg", "a marker with its holder weighs a few grams")
    marker_2: float = parameter(0.0, 0.0, 0.01, "kg", "a marker with its holder weighs a few grams")
    marker_3: float = parameter(0.0, 0.0, 0.01, "kg", "a marker with its holder weighs a few grams")
    marker_4: float = parameter(0.0, 0.0, 0.01, "kg", "a marker with its holder weighs a few grams")

    def on(self, parts: ArmParts) -> ArmParts:
        rod, masses = parts.rod, (self.marker_1, self.marker_2, self.marker_3, self.marker_4)
        weight = jnp.asarray(rod.weight)
        for node, mass in zip(MARKER_NODES, masses, strict=True):
            point = 2 * node - 1
            weight = weight.at[point].add(mass * G / rod.ds[point])
        return replace(parts, rod=replace(rod, weight=weight))
