"""Actuators that bend only above a threshold pressure."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, parameter, shape_parameter


class ActuatorThreshold(ActingPressure):
    """A part p_0 of the pressure unfolds the walls or takes up slack, and does not bend the body.

        p_act = p - p_0 p/(p^2 + (w + p_0)^2)^(1/2)

    Far above w + p_0, the loss is p_0. At small pressures, p_act is p w/(w + p_0). Source: dead
    space of an input, Doebelin, E. O. (2003), Measurement Systems, 5th ed., McGraw-Hill, ch. 3.
    """

    title = "the actuators need a threshold pressure"
    order = 710

    threshold: Scalar = parameter(
        0.0, 0.0, 60e3, "Pa", "slack walls and folds take up to a quarter of 250 kPa"
    )
    """p_0, lost pressure."""
    width: Scalar = shape_parameter(
        20e3, 2e3, 150e3, "Pa", "1 to 60 % of a drive amplitude of 250 kPa"
    )
    """w, width of the transition at small pressures."""

    def act(self, p, memory, dt):
        loss = self.threshold * p / jnp.sqrt(p**2 + (self.width + self.threshold) ** 2)
        return p - loss, memory
