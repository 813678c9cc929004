"""Weight of the markers and their holders."""

from dataclasses import replace

import jax.numpy as jnp

from calibration.tentacle.arm import CELLS, LENGTH, MARKER_S, ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from slider_jax.beam.parameters import G
from slider_jax.effects.base import parameter


class MarkerMass(AbstractArmEffect):
    """The markers have masses. The masses act on the axis, in the cells of the markers."""

    marker_1: float = parameter(0.0, 0.0, 0.01, "kg", "a marker with its holder weighs a few grams")
    marker_2: float = parameter(0.0, 0.0, 0.01, "kg", "a marker with its holder weighs a few grams")
    marker_3: float = parameter(0.0, 0.0, 0.01, "kg", "a marker with its holder weighs a few grams")
    marker_4: float = parameter(0.0, 0.0, 0.01, "kg", "a marker with its holder weighs a few grams")

    def on(self, parts: ArmParts) -> ArmParts:
        rod, masses = parts.rod, (self.marker_1, self.marker_2, self.marker_3, self.marker_4)
        weight = jnp.asarray(rod.weight)
        for s, mass in zip(MARKER_S, masses, strict=True):
            cell = min(int(s / LENGTH * CELLS), CELLS - 1)
            weight = weight.at[cell].add(mass * G / rod.ds[cell])
        return replace(parts, rod=replace(rod, weight=weight))
