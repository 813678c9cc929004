"""Energy balance of the body: power input, stored energy, dissipation and work on the effects.

The momentum balance of `beam.equations`, multiplied by the velocities and integrated, is

    P_clamp + P_chambers = d(kinetic + bending + stretching)/dt + dissipated + given away

    P_clamp    = [T V_tau + N V_n + M omega] at the head         P_chambers = int M_act kappa_t ds
    kinetic    = int m (V_tau^2 + V_n^2)/2 ds
    bending    = int EI kappa^2/2 ds                             stretching = int EA eps^2/2 ds
    dissipated = int alpha (EI kappa_t^2 + EA eps_t^2) ds
    given away = -int (1 + eps) (F_tau V_tau + F_n V_n) ds, one term for each effect.

The product rule is exact for the means and slopes of the box method. At every stage, the discrete
equations therefore satisfy this balance to the solver's tolerance. The residual of the balance,
integrated over a stride, is the error of the time integration.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.state import fields
from slider_jax.dynamics.residual import turning_rate
from slider_jax.dynamics.step import Snapshot
from slider_jax.effects.base import force_of
from slider_jax.observables import StoredEnergy, chamber_power


class EnergyRates(eqx.Module):
    """Powers [W] at one instant; scalars unless a shape is given."""

    chambers: Float[Array, "2"]
    """Power input by the couples of the front and rear chamber."""
    clamp: Float[Array, ""]
    """Power input by the support."""
    stored: StoredEnergy
    """Rates of change [W] of the stored energies."""
    dissipated_bending: Float[Array, ""]
    dissipated_stretching: Float[Array, ""]
    given: tuple[Float[Array, ""], ...]
    """Power that each effect takes from the body, in the model's order. Drag and reactive force
    give the power to the water (in the tank's frame), and gravity to potential energy."""

    @property
    def put_in(self) -> Float[Array, ""]:
        """Power input by chambers and support."""
        return jnp.sum(self.chambers, axis=-1) + self.clamp

    @property
    def dissipated(self) -> Float[Array, ""]:
        """Power dissipated by the viscosity of the body."""
        return self.dissipated_bending + self.dissipated_stretching

    @property
    def to_effects(self) -> Float[Array, ""]:
        """Power that all effects take from the body."""
        return sum(self.given, jnp.zeros_like(self.clamp))


def clamp_power(x: Snapshot) -> Float[Array, ""]:
    """Returns the power [W] of the support on the body: T V_tau + N V_n + M omega at the head.

    The power is zero for a clamp at rest, and -(thrust times speed) for a towed clamp.
    """
    head = fields(x.y[:, -1])
    return head.T * head.V_tau + head.N * head.V_n + head.M * turning_rate(head, x.stage)


def energy_rates(x: Snapshot) -> EnergyRates:
    """Returns every term of the energy balance at one instant."""
    section, body, integral = x.section(), x.mesh.structure, x.mesh.grid.integral
    stretch = 1.0 + section.strain

    def given(effect):
        F_tau, F_n = force_of(effect, section)
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
