"""Pulsed valves whose flow goes with the pressure difference."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import parameter
from slider_jax.effects.valve_pair import ValvePair


class PulsedValves(ValvePair):
    """As `FirmwareValves`, with laminar flow in place of the orifice's.

        dp/dt = c_f u (p_s - |p|)    filling, of the sign of p_set - p
        dp/dt = c_v u |p|            venting, of the sign of p_set - p

    Source: laminar restriction, Andersen, B. W. (1967), The analysis and design of pneumatic
    systems, Wiley; firmware: bvanstratum/SoftSnakePressureControl.
    """

    title = "pulsed valves of the firmware, laminar"
    order = 170

    fill: Scalar = parameter(
        0.0,
        0.0,
        10.0,
        "1/s",
        "0.1 l by a valve of 1 mm fills in a fraction of a second",
        1.5,
    )
    """c_f, of the fill valve."""
    vent: Scalar = parameter(
        2.0, 0.05, 10.0, "1/s", "0.1 l by a valve of 1 mm empties in a fraction of a second"
    )
    """c_v, of the vent valve."""
    supply: Scalar = parameter(
        600e3, 200e3, 1.1e6, "Pa", "regulators and compressors of laboratories, gauge"
    )
    """p_s, gauge."""
    dead: Scalar = parameter(0.05, 0.0, 0.5, "-", "pulses too short to lift the armature")
    """Duty below which a valve stays shut."""

    def flows(self, p):
        return self.fill * jnp.maximum(self.supply - p, 0.0), self.vent * p
