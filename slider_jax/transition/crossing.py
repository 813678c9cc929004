"""Simulates the way from the water to the wall, as pure functions of model and time.

The x axis points up, and the head starts at the origin. The energy balance from the start is

    W = E + G + R + D + S + error of the time steps

W is the work of the chambers, E the kinetic and elastic energy, G the energy given to weight and
buoyancy, R the energy given to the water, D the energy that the body's viscosity and its other
effects dissipate, and S the energy given to the spines.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax import observables as obs
from slider_jax.actuation import ScheduledSquareWave, rear_of
from slider_jax.beam.clock import Clock
from slider_jax.beam.parameters import G, Numerics, Scalar
from slider_jax.beam.state import fields, to_plane
from slider_jax.beam.waterline import Waterline
from slider_jax.dynamics.model import Drive, Model
from slider_jax.dynamics.residual import turning_rate
from slider_jax.dynamics.rollout import TimeGrid, continued
from slider_jax.dynamics.step import Carry, Snapshot
from slider_jax.dynamics.time_schemes import SDIRK2, Scheme
from slider_jax.effects import Gravity, WaterMotion, total_force
from slider_jax.effects.base import Mounting
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, to_model
from slider_jax.experiment.transition_table import TransitionTable
from slider_jax.supports import GrippingLink, Spines


class GaitSchedule(NamedTuple):
    """The gait at increasing times, in SI units; every field has the shape (knots,).

    The fields are those of `GaitAt`. Between the times, all values are linear.
    """

    time: Array
    frequency: Array
    front: Array
    rear: Array
    phase: Array
    bias: Array
    grip_phase: Array


def schedule_of(table: TransitionTable) -> GaitSchedule:
    """Returns the schedule of a table [transition]."""
    return GaitSchedule(
        *(jnp.array([getattr(x, name) for x in table.schedule], float)
          for name in GaitSchedule._fields)
    )  # fmt: skip


class CrossingSettings(NamedTuple):
    """Numerical settings on the way."""

    step: float
    """Length of a time step [s]."""
    block: int
    """Number of time steps that are simulated at once."""
    numerics: Numerics
    scheme: Scheme = SDIRK2


class CrossingSeries(eqx.Module):
    """The way, sampled at the end of each time step. The x axis points up from the surface."""

    head: Float[Array, "steps 2"]
    """Place (up, left) [m] of the head, from the surface above the start."""
    centre: Float[Array, "steps 2"]
    """Centre of mass (up, left) [m]."""
    midline: Float[Array, "steps 2 nodes"]
    """Midlines (up, left) [m], from tail to head."""
    angle: Float[Array, " steps"]
    """Angle of the head [rad] to the upward direction, positive to the left."""
    wet: Float[Array, " steps"]
    """Fraction [-] of the robot's length that is wet."""
    status: Float[Array, "steps 2"]
    """Status of the left and the right grip; see `slider_jax.supports.gripping`."""
    load: Float[Array, "steps 2"]
    """Force [N] of the left and the right grip."""
    power: Float[Array, " steps"]
    """Power [W] of the chambers on the body."""
    to_weight: Float[Array, " steps"]
    """Power [W] that the body gives to its weight and buoyancy."""
    to_water: Float[Array, " steps"]
    """Power [W] that the body gives to the water."""
    to_body: Float[Array, " steps"]
    """Power [W] that the body's viscosity and its other effects dissipate."""
    to_spines: Float[Array, " steps"]
    """Power [W] that the cross-link gives to the spines."""
    stored: Float[Array, " steps"]
    """Kinetic and elastic energy [J]."""


def to_crosser(experiment: Experiment) -> Model:
    """Returns the model of the robot on its way from the water to the wall.

    Weight and buoyancy replace the effect `gravity` of the file; the clamp of the carriage is
    omitted. Raises `InputError` without a table [transition] or without a density of the robot, and
    for effects that move the water or add inertia without weight.
    """
    table = experiment.transition
    if table is None:
        raise InputError(
            "transition: missing; add the table [transition] with the depth at the start and the "
            "gait's schedule to the experiment file"
        )
    model = to_model(experiment, 0)
    if model.water is not None:
        raise InputError("water: given moving water; allowed is still water below the surface")
    if not experiment.robot.has_density:
        raise InputError(
            "robot.density: missing; give the robot's mean density, which sets its buoyancy"
        )
    for effect in model.effects:
        if isinstance(effect, WaterMotion) or effect.lacks_weight:
            why = "moves the water" if isinstance(effect, WaterMotion) else "has no weight"
            raise InputError(f"effects: given {effect.name()}, which {why}; remove this effect")
    kept = [e for e in model.effects if not isinstance(e, Mounting) and e.vertical() is None]
    weight = Gravity(G, density=experiment.robot.water_density)
    spines = Spines(**table.spines.model_dump())
    schedule = schedule_of(table)
    link = GrippingLink(
        spines,
        Clock(schedule.time, schedule.frequency),
        table.link,
        wall_from=table.depth + table.wall_from,
        speed=table.start_speed,
        heading=table.heading,
    )
    model = eqx.tree_at(
        lambda m: (m.effects, m.support, m.waterline),
        model,
        ((*kept, weight), link, Waterline(table.depth, 0.0, table.thickness)),
        is_leaf=lambda x: x is None,
    )
    model = with_schedule(model, schedule)
    return jax.tree.map(lambda x: jnp.asarray(x, float), model)


def with_schedule(model: Model, schedule: GaitSchedule) -> Model:
    """Returns the crosser with another schedule; differentiable in the schedule's values."""
    assert isinstance(model.support, GrippingLink)
    clock = Clock(schedule.time, schedule.frequency)
    waves = tuple(
        ScheduledSquareWave(
            clock, (1.0 - r) * schedule.front + r * schedule.rear, r * schedule.phase, schedule.bias
        )
        for r in rear_of(len(model.robot.chambers))
    )
    link = eqx.tree_at(
        lambda x: (x.clock, x.phase), model.support, (clock, schedule.grip_phase),
    )  # fmt: skip
    return eqx.tree_at(lambda m: (m.drive, m.support), model, (Drive(waves), link))


def _saved(x: Snapshot) -> CrossingSeries:
    section, grid, link, line = x.section(), x.mesh.grid, x.stage.support, x.stage.immersion
    assert isinstance(link, GrippingLink) and line is not None
    head = fields(x.y[:, -1])
    omega = turning_rate(head, x.stage)
    midline = obs.midline(x)
    weight = tuple(e for e in x.stage.effects if e.vertical() is not None)
    lost = obs.losses(x)
    forces, grips = link.grips(head, omega)
    ends = jnp.stack(
        [jnp.stack(to_plane(head.V_tau - arm * omega, head.V_n, head.phi)) for arm in link.arms()]
    )
    mass = grid.integral(section.linear_density)
    return CrossingSeries(
        head=x.head,
        centre=grid.integral(section.linear_density * grid.mid(midline)) / mass,
        midline=midline,
        angle=head.phi,
        wet=grid.integral(line.wet) / grid.integral(jnp.ones_like(line.wet)),
        status=grips.status,
        load=grips.load,
        power=jnp.sum(obs.chamber_power(x)),
        to_weight=obs.power_given_to(total_force(weight, section), x),
        to_water=lost.to_water,
        to_body=lost.to_body,
        to_spines=-jnp.sum(forces * ends),
        stored=obs.stored_energy(x).total,
    )


def continue_crossing(
    model: Model, carry: Carry, t0: Scalar, settings: CrossingSettings
) -> tuple[Carry, CrossingSeries]:
    """Simulates a block of time steps that starts at `t0` [s]; heights are from the surface."""
    assert model.waterline is not None
    times = TimeGrid(settings.step, settings.block, t0)
    run = continued(carry, model, times, _saved, settings.numerics, settings.scheme)
    level = jnp.stack([jnp.asarray(model.waterline.level, float), jnp.zeros(())])
    saved = run.saved
    moved = saved.head - level, saved.centre - level, saved.midline - level[:, None]
    return run.final, eqx.tree_at(lambda s: (s.head, s.centre, s.midline), saved, moved)
