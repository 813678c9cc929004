"""Valves of the rig, pulsed by the published firmware, with choked or subsonic flow."""

import math

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import parameter
from slider_jax.effects.pneumatics.chamber_expansion import ATMOSPHERE
from slider_jax.effects.pneumatics.orifice_flow import characteristic
from slider_jax.effects.valve_pair import ValvePair


class FirmwareValves(ValvePair):
    """Two pulsed valves, one to the supply and one to the atmosphere, replace the lag.

        dp/dt =  c_f u P_s psi((p_a + |p|)/P_s)            filling, with the sign of p_set - p
        dp/dt =  c_v u (p_a + |p|) psi(p_a/(p_a + |p|))    venting, with the sign of p_set - p
        psi(r) = sqrt(1 - ((r - b)/(1 - b))^2),    1 for r < b

    u is the opening of the valve at the error p_set - p (`valve_pair.opening`). P_s = p_a + p_s is
    the absolute supply pressure, and p_a the atmospheric pressure. psi is the flow divided by the
    choked flow, and r the downstream pressure divided by the upstream pressure. The flow is choked
    for r < b. At c_f = 0, the lag is unchanged. At c_f > 0, the valves replace the lag. Source: ISO
    6358-1 (2013), Pneumatic fluid power: determination of flow-rate characteristics of components;
    firmware: bvanstratum/SoftSnakePressureControl.
    """

    title = "pulsed valves of the firmware with choked or subsonic flow"
    order = 160

    fill: Scalar = parameter(
        0.0, 0.0, 8.0, "1/s", "a valve of 1 mm fills 0.1 l in a fraction of a second", 1.5
    )
    """c_f, choked flow of the fill valve divided by the chamber's volume."""
    vent: Scalar = parameter(
        1.5,
        0.05,
        8.0,
        "1/s",
        "a valve of 1 mm empties 0.1 l in a fraction of a second",
        physical=(0.0, math.inf),
    )
    """c_v, choked flow of the vent valve divided by the chamber's volume."""
    supply: Scalar = parameter(
        450e3,
        200e3,
        1.1e6,
        "Pa",
        "gauge pressures of laboratory regulators and compressors",
        physical=(0.0, math.inf),
    )
    """p_s, gauge pressure of the supply."""
    critical: Scalar = parameter(
        0.3, 0.1, 0.6, "-", "0.2 to 0.5 for valves, 0.528 for a nozzle", physical=(0.0, 0.95)
    )
    """b, critical pressure ratio."""
    dead: Scalar = parameter(
        0.05, 0.0, 0.5, "-", "short pulses do not lift the armature", physical=(0.0, 0.95)
    )
    """Duty cycle below which a valve stays closed, as a fraction of full duty."""

    def flows(self, p):
        inside, supply = ATMOSPHERE + p, ATMOSPHERE + self.supply
        fill = self.fill * supply * characteristic(inside / supply, self.critical)
        vent = self.vent * inside * characteristic(ATMOSPHERE / inside, self.critical)
        return fill, vent
