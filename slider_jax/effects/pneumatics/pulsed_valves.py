"""Pulsed valves with laminar flow."""

import math

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import parameter
from slider_jax.effects.valve_pair import ValvePair


class PulsedValves(ValvePair):
    """Two pulsed valves as in `FirmwareValves`, with laminar flow instead of orifice flow.

        dp/dt = c_f u (p_s - |p|)    filling, with the sign of p_set - p
        dp/dt = c_v u |p|            venting, with the sign of p_set - p

    u is the opening of the valve at the error p_set - p (`valve_pair.opening`). Source: laminar
    restriction, Andersen, B. W. (1967), The analysis and design of pneumatic systems, Wiley;
    firmware: bvanstratum/SoftSnakePressureControl.
    """

    title = "pulsed valves of the firmware with laminar flow"
    order = 170

    fill: Scalar = parameter(
        0.0, 0.0, 10.0, "1/s", "a valve of 1 mm fills 0.1 l in a fraction of a second", 1.5
    )
    """c_f, laminar conductance of the fill valve."""
    vent: Scalar = parameter(
        2.0,
        0.05,
        10.0,
        "1/s",
        "a valve of 1 mm empties 0.1 l in a fraction of a second",
        physical=(0.0, math.inf),
    )
    """c_v, laminar conductance of the vent valve."""
    supply: Scalar = parameter(
        600e3,
        200e3,
        1.1e6,
        "Pa",
        "gauge pressures of laboratory regulators and compressors",
        physical=(0.0, math.inf),
    )
    """p_s, gauge pressure of the supply."""
    dead: Scalar = parameter(
        0.05, 0.0, 0.5, "-", "short pulses do not lift the armature", physical=(0.0, 0.95)
    )
    """Duty cycle below which a valve stays closed, as a fraction of full duty."""

    def flows(self, p):
        return self.fill * jnp.maximum(self.supply - p, 0.0), self.vent * p
