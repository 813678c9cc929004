"""Computes energies stored in the body and the power of the chambers (symbols: glossary).

kinetic = int m (V_tau^2 + V_n^2)/2 ds      bending    = int EI kappa^2/2 ds
P       = int M_act kappa_t ds              stretching = int EA eps^2/2 ds
"""

from dataclasses import replace

import equinox as eqx
from jaxtyping import Array, Float

from slider_jax.dynamics.residual import forces_and_states
from slider_jax.dynamics.step import Snapshot


class StoredEnergy(eqx.Module):
    """Energies [J] stored in the body; scalars."""

    kinetic: Float[Array, ""]
    bending: Float[Array, ""]
    stretching: Float[Array, ""]

    @property
    def total(self) -> Float[Array, ""]:
        return self.kinetic + self.bending + self.stretching


def stored_energy(x: Snapshot) -> StoredEnergy:
    """Returns the kinetic, bending and stretching energy [J] of the body."""
    section, body, integral = x.section(), x.mesh.structure, x.mesh.grid.integral
    return StoredEnergy(
        kinetic=integral(0.5 * body.linear_density * (section.V_tau**2 + section.V_n**2)),
        bending=integral(0.5 * section.EI * section.kappa**2),
        stretching=integral(0.5 * body.EA * section.strain**2),
    )


def chamber_power(x: Snapshot) -> Float[Array, " chambers"]:
    """Returns the mechanical power [W] of each chamber on the body.

    The power is int K_Q p kappa_t ds in the chamber's span, without losses of valves and supply. It
    is positive while the body bends in the direction of the chamber's moment.
    """
    return x.mesh.grid.integral(x.chambers.acting[:, None] * x.mesh.chambers * x.section().kappa_t)


class Losses(eqx.Module):
    """Powers [W] that leave the moving body, without the power of its weight; scalars."""

    to_water: Float[Array, ""]
    """Power that the body gives to the force densities of the effects except weight."""
    to_body: Float[Array, ""]
    """Power that the body's viscosity and the moments of effects dissipate."""


def losses(x: Snapshot) -> Losses:
    """Returns the powers [W] that the body loses to the water, to its viscosity and to effects."""
    section, integral = x.section(), x.mesh.grid.integral
    others = tuple(e for e in x.stage.effects if e.vertical() is None)
    force, moment, _ = forces_and_states(section, replace(x.stage, effects=others))
    damped = section.EI * section.kappa_t**2 + section.EA * section.strain_t**2
    return Losses(
        to_water=power_given_to(force, x),
        to_body=integral(section.damping_time * damped + moment * section.kappa_t),
    )


def power_given_to(force: tuple[Array, Array], x: Snapshot) -> Float[Array, ""]:
    """Returns the power [W] that the body gives to a force per length (F_tau, F_n) [N/m] on it."""
    section, (F_tau, F_n) = x.section(), force
    power = F_tau * section.V_tau + F_n * section.V_n
    return -x.mesh.grid.integral((1.0 + section.strain) * power)
