"""Proportional solenoid valves of the rig, driven by the published firmware."""

import math

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter
from slider_jax.effects.pneumatics.chamber_expansion import ATMOSPHERE
from slider_jax.effects.pneumatics.orifice_flow import characteristic
from slider_jax.effects.valve_pair import duty

WHY_FLOW = "a valve of 1 mm fills or empties 0.1 l in a fraction of a second"
WHY_HALF = "proportional valves open between a fifth and nine tenths of the largest current"
WHY_CRITICAL = "0.2 to 0.5 for valves, 0.528 for a nozzle; more if other parts limit the flow"


class ProportionalValves(Flow):
    """A proportional fill valve and a proportional vent valve replace the lag.

        d|p|/dt   = c_f u_f P_s psi((p_a + |p|)/P_s, b_f)
                  - c_v u_v (p_a + |p|) psi(p_a/(p_a + |p|), b_v)
        tau du/dt = d^n/(d^n + h^n) - u

    u_f and u_v are the openings of the valves, and d is the duty at the error p_set - p
    (`valve_pair.duty`) of the valve that this error drives; d is zero for the other valve. A spring
    holds the armature of a proportional valve. The flow therefore hardly begins below a threshold
    of the current, and saturates above it. The valve has half of its flow at the duty h. P_s = p_a
    + p_s is the absolute supply pressure, and p_a the atmospheric pressure. psi(r, b) is the flow
    divided by the choked flow (`orifice_flow.characteristic`). At c_f = 0, the lag is unchanged.
    The S-shape of the opening was chosen with the rig's ten pressure logs. If the
    sign of the pressure changes, the openings keep their values. Source: the
    paper, section on the pressure control manifold, for the valves; ISO 6358-1 (2013) for psi;
    bvanstratum/SoftSnakePressureControl for the duty.
    """

    title = "proportional valves with a threshold and a saturation"
    order = 165
    states = 2
    replaces_law = "lag"

    fill: Scalar = parameter(0.0, 0.0, 8.0, "1/s", WHY_FLOW, 1.5)
    """c_f, choked flow of the fill valve divided by the chamber's volume."""
    vent: Scalar = parameter(1.5, 0.05, 8.0, "1/s", WHY_FLOW, physical=(0.0, math.inf))
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
    critical_fill: Scalar = parameter(0.3, 0.0, 0.95, "-", WHY_CRITICAL, physical=(0.0, 0.95))
    """b_f, critical pressure ratio of the fill valve."""
    critical_vent: Scalar = parameter(0.5, 0.0, 0.95, "-", WHY_CRITICAL, physical=(0.0, 0.95))
    """b_v, critical pressure ratio of the vent valve."""
    half_fill: Scalar = parameter(0.5, 0.2, 0.9, "-", WHY_HALF, physical=(0.01, math.inf))
    """h of the fill valve, duty at half of the flow, as a fraction of full duty."""
    half_vent: Scalar = parameter(0.5, 0.2, 0.9, "-", WHY_HALF, physical=(0.01, math.inf))
    """h of the vent valve."""
    steepness: Scalar = parameter(
        4.0,
        1.0,
        20.0,
        "-",
        "from a valve without threshold to an on-off valve",
        physical=(1.0, 50.0),
    )
    """n, steepness of the S-shape."""

    response: Scalar = parameter(
        5e-3, 1e-3, 5e-2, "s", "data sheets of small proportional valves", physical=(1e-3, math.inf)
    )
    """tau, time constant of the opening."""

    def rate(self, rate, x):
        p = jnp.abs(x.p)
        inside, supply = ATMOSPHERE + p, ATMOSPHERE + self.supply
        fill = self.fill * supply * characteristic(inside / supply, self.critical_fill)
        vent = self.vent * inside * characteristic(ATMOSPHERE / inside, self.critical_vent)
        filled, vented = x.states
        return jnp.where(self.replaces(), x.side * (filled * fill - vented * vent), rate)

    def state_rates(self, rate, x):
        wanted = duty(x.p_set - x.p)
        fill = self._opening(jnp.where(x.filling, wanted, 0.0), self.half_fill)
        vent = self._opening(jnp.where(x.filling, 0.0, wanted), self.half_vent)
        return (jnp.stack([fill, vent]) - x.states) / self.response

    def replaces(self):
        return self.fill > 0.0

    def _opening(self, given: Array, half: Scalar) -> Array:
        """Returns the share of the flow at the duty `given`."""
        # At zero, the derivative of a power with respect to the exponent is undefined.
        power = (jnp.maximum(given, 1e-6) / half) ** self.steepness
        return power / (1.0 + power)
