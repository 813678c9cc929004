"""Simulates climbing strides of a robot on alternating pins, as pure functions.

The x axis points up. While one end of the cross-link is pinned, the body swings the free end up.
Then the free end is pinned. The energy balance of whole strides, from time 1 to time 2, is

    W = m g (x_2 - x_1) + D + (E_2 - E_1) + error of the time steps

W is the work of the chambers, m g the weight, x the height of the centre of mass, D the dissipated
energy, and E the kinetic and elastic energy. Pinning stops a moving end and excites waves. D
includes the dissipation of these waves.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from slider_jax import observables as obs
from slider_jax.beam.parameters import G, Numerics, Scalar
from slider_jax.beam.state import fields
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.residual import turning_rate
from slider_jax.dynamics.rollout import TimeGrid, continued
from slider_jax.dynamics.step import Carry, Snapshot, at_rest, with_motion
from slider_jax.dynamics.time_schemes import SDIRK2, Scheme
from slider_jax.supports import PinnedLink
from slider_jax.swimming.steady_state import STRIDES_BEFORE_START


class ClimbPlan(NamedTuple):
    """Number of strides and numerical settings of a climb."""

    settling: int = 15
    """Number of strides after the start that the averages exclude."""
    strides: int = 15
    """Number of strides over which speed and power are averaged (the paper's value)."""
    steps_per_stride: int = 96
    numerics: Numerics = Numerics(tail_cells=6, body_cells=24)
    scheme: Scheme = SDIRK2


class ClimbSeries(eqx.Module):
    """A climb, sampled at the end of each time step; the x axis points up."""

    midline: Float[Array, "steps 2 nodes"]
    """Midlines [m], from tail to head."""
    centre: Float[Array, "steps 2"]
    """Centre of mass [m]."""
    pin: Float[Array, "steps 2"]
    """Position of the pin [m]."""
    slip: Float[Array, " steps"]
    """Speed of the pinned end of the cross-link [m/s], a measure of the solver's error."""
    angle: Float[Array, " steps"]
    """Angle of the head [rad], positive to the left."""
    power: Float[Array, " steps"]
    """Power of the chambers on the body [W]."""
    dissipated: Float[Array, " steps"]
    """Power [W] that the body's viscosity and all effects except `Gravity` dissipate."""
    stored: Float[Array, " steps"]
    """Kinetic and elastic energy [J]."""


class Climb(eqx.Module):
    """Performance over whole strides; all fields are scalars unless a shape is given."""

    speed: Scalar
    """Upward speed U of the centre of mass [m/s]."""
    drift: Scalar
    """Speed of the centre of mass to the left [m/s]."""
    power: Scalar
    """Mean power P of the chambers on the body [W]."""
    efficiency: Scalar
    """Weight times U/(P - dE/dt) [-] with the stored energy E. The mean dE/dt is zero if strides
    repeat. All ratios to P are NaN if the chambers do no positive work."""
    dissipated: Scalar
    """Fraction of P that is dissipated [-]."""
    stored: Scalar
    """Fraction of P that becomes kinetic and elastic energy [-]."""
    unaccounted: Scalar
    """Residual of the energy balance as a fraction of P [-]: the error of the time steps."""
    swing: Scalar
    """Peak-to-peak angle of the head [rad]."""
    tail_swing: Scalar
    """Peak-to-peak lateral motion of the tip in the last stride [m]."""
    slip: Scalar
    """Largest speed of the pinned end of the cross-link [m/s], a measure of the solver's error."""
    rises: Float[Array, " strides"]
    """Rise of the head in each stride [m]."""


def _saved(x: Snapshot) -> ClimbSeries:
    cell, grid, support = x.section(), x.mesh.grid, x.stage.support
    head = fields(x.y[:, -1])
    midline = obs.midline(x)
    rates = support.anchor_velocity(head, turning_rate(head, x.stage), x.t)
    lost = obs.losses(x)
    return ClimbSeries(
        midline=midline,
        centre=grid.integral(grid.mid(midline)) / grid.integral(jnp.ones_like(cell.s)),
        pin=x.head + support.anchor_offset(head.phi, x.t),
        slip=jnp.linalg.norm(rates),
        angle=head.phi,
        power=jnp.sum(obs.chamber_power(x)),
        dissipated=lost.to_water + lost.to_body,
        stored=obs.stored_energy(x).total,
    )


def hanging(model: Model, numerics: Numerics) -> Carry:
    """Returns a straight body at rest, with its centre of mass below the left pin."""
    assert isinstance(model.support, PinnedLink)
    angle = -jnp.arctan2(model.support.link_length, model.body.length)
    return with_motion(at_rest(model, numerics), lambda motion: motion.at[..., 2, :].add(angle))


def climb_on(
    model: Model, frequency: Scalar, carry: Carry, count: int, plan: ClimbPlan
) -> tuple[Carry, ClimbSeries]:
    """Simulates `count` strides at `frequency` [Hz], starting when the left end is pinned.

    `model` must be a climber from `to_climber`. For every pin phase, the pinned end changes at the
    end of a time step. Edges of the set pressures may be within time steps.
    """
    assert isinstance(model.support, PinnedLink)
    steps = plan.steps_per_stride
    begin = (STRIDES_BEFORE_START + model.support.phase) / frequency
    times = TimeGrid(1.0 / (frequency * steps), count * steps, begin)
    run = continued(carry, model, times, _saved, plan.numerics, plan.scheme)
    return run.final, run.saved


def climb_of(model: Model, frequency: Scalar, series: ClimbSeries, plan: ClimbPlan) -> Climb:
    """Returns the performance over whole strides; `series` starts one step before the strides."""
    steps = plan.steps_per_stride
    h = 1.0 / (frequency * steps)
    span = h * (len(series.angle) - 1)
    weight = model.body.mass * G
    work, lost = (h * jnp.sum(x[1:]) for x in (series.power, series.dissipated))
    (up, left), kept = (x[-1] - x[0] for x in (series.centre, series.stored))
    lifted, spent = weight * up, jnp.where(work > 0.0, work, jnp.nan)
    head, tip = series.midline[:, :, -1], series.midline[-steps:, 1, 0]
    return Climb(
        speed=up / span,
        drift=left / span,
        power=work / span,
        efficiency=jnp.where(spent > kept, lifted / (spent - kept), jnp.nan),
        dissipated=lost / spent,
        stored=kept / spent,
        unaccounted=(work - lifted - lost - kept) / spent,
        swing=jnp.max(series.angle) - jnp.min(series.angle),
        tail_swing=jnp.max(tip) - jnp.min(tip),
        slip=jnp.max(series.slip),
        rises=jnp.diff(head[::steps, 0]),
    )


def join(before: ClimbSeries, after: ClimbSeries) -> ClimbSeries:
    """Returns `after`, preceded by the last time step of `before`."""
    return jax.tree.map(lambda a, b: jnp.concatenate([a[-1:], b]), before, after)


def climb_from_rest(
    model: Model, frequency: Scalar, plan: ClimbPlan = ClimbPlan()
) -> tuple[Climb, Bool[Array, ""]]:
    """Returns the performance of a climb from rest, and whether all time steps converged.

    The average covers `plan.strides` strides after `plan.settling` strides. Supports `vmap`.
    """
    begin = hanging(model, plan.numerics)
    carry, before = climb_on(model, frequency, begin, plan.settling, plan)
    carry, after = climb_on(model, frequency, carry, plan.strides, plan)
    return climb_of(model, frequency, join(before, after), plan), carry.ok
