"""Energy: where it comes from, where it is kept, where it goes.

The balance of momentum in `beam.py`, times the velocities, integrated over the body:

    P_clamp + P_chambers = d(kinetic + bending + stretching)/dt + dissipated + given away

    P_clamp    = [T V_tau + N V_n + M omega] at the head         P_chambers = int M_act kappa_t ds
    kinetic    = int m (V_tau^2 + V_n^2)/2 ds
    bending    = int EI kappa^2/2 ds                             stretching = int EA eps^2/2 ds
    dissipated = int alpha (EI kappa_t^2 + EA eps_t^2) ds
    given away = -int (1 + eps) (F_tau V_tau + F_n V_n) ds, one term for each effect.

The product rule holds exactly for the box method's means and slopes, so the discrete equations
satisfy this at every stage to the solver's tolerance; what is left over a stride is the error in
time.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.state import fields
from slider_jax.dynamics.residual import turning_rate
from slider_jax.dynamics.step import Snapshot


class StoredEnergy(eqx.Module):
    """Energy [J] in the body; scalars."""

    kinetic: Float[Array, ""]
    bending: Float[Array, ""]
    stretching: Float[Array, ""]

    @property
    def total(self) -> Float[Array, ""]:
        return self.kinetic + self.bending + self.stretching


class EnergyRates(eqx.Module):
    """Powers [W] at one instant; scalars where no shape is given."""

    chambers: Float[Array, "2"]
    """Put in by the front and the rear chamber's couples."""
    clamp: Float[Array, ""]
    """Put in by the support."""
    stored: StoredEnergy
    """Rate of change [W] of what the body stores."""
    dissipated_bending: Float[Array, ""]
    dissipated_stretching: Float[Array, ""]
    given: tuple[Float[Array, ""], ...]
    """Given away through each of the model's effects, in their order: to the water by drag and
    reactive force (in the tank's frame), to height by gravity."""

    @property
    def put_in(self) -> Float[Array, ""]:
        """By chambers and support."""
        return jnp.sum(self.chambers, axis=-1) + self.clamp

    @property
    def dissipated(self) -> Float[Array, ""]:
        """In the body's own viscosity."""
        return self.dissipated_bending + self.dissipated_stretching

    @property
    def to_effects(self) -> Float[Array, ""]:
        """Given away through all effects."""
        return sum(self.given, jnp.zeros_like(self.clamp))


def stored_energy(x: Snapshot) -> StoredEnergy:
    """Kinetic, bending and stretching energy [J] of the body."""
    section, body, integral = x.section(), x.mesh.structure, x.mesh.grid.integral
    return StoredEnergy(
        kinetic=integral(0.5 * body.linear_density * (section.V_tau**2 + section.V_n**2)),
        bending=integral(0.5 * body.EI * section.kappa**2),
        stretching=integral(0.5 * body.EA * section.strain**2),
    )


def chamber_power(x: Snapshot) -> Float[Array, "2"]:
    """Power [W] that the front and rear chamber put into the body: int K_Q p w kappa_t ds.

    Positive while the body bends the way the chamber pushes; mechanical, without the losses of
    valves and supply.
    """
    return x.mesh.grid.integral(x.chambers.acting[:, None] * x.mesh.chambers * x.section().kappa_t)


def clamp_power(x: Snapshot) -> Float[Array, ""]:
    """Power [W] that the support puts into the body: T V_tau + N V_n + M omega at the head.

    Zero for a clamp at rest; -thrust times speed for a towed one.
    """
    head = fields(x.y[:, -1])
    return head.T * head.V_tau + head.N * head.V_n + head.M * turning_rate(head, x.stage)


def energy_rates(x: Snapshot) -> EnergyRates:
    """Every term of the module's balance at one instant."""
    section, body, integral = x.section(), x.mesh.structure, x.mesh.grid.integral
    stretch = 1.0 + section.strain

    def given(effect):
        F_tau, F_n = effect.force(section)
        return -integral(stretch * (F_tau * section.V_tau + F_n * section.V_n))

    accelerating = section.V_tau * section.V_tau_t + section.V_n * section.V_n_t
    return EnergyRates(
        chambers=chamber_power(x),
        clamp=clamp_power(x),
        stored=StoredEnergy(
            kinetic=integral(body.linear_density * accelerating),
            bending=integral(body.EI * section.kappa * section.kappa_t),
            stretching=integral(body.EA * section.strain * section.strain_t),
        ),
        dissipated_bending=integral(body.damping_time * body.EI * section.kappa_t**2),
        dissipated_stretching=integral(body.damping_time * body.EA * section.strain_t**2),
        given=tuple(given(effect) for effect in x.stage.effects),
    )
