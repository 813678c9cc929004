"""Steady swimming: the speed at which the mean force along the course vanishes over a stride.

What shakes out of a gait within a few strides, shape and recoil and turning, is left to time
stepping; the speed, which takes many, is sought as a root. After some strides the whole body is
given the speed that a secant through the last two paces asks for, and goes on:

    a(U) = (v_2 - v_1) . ahead / T,    a(U*) = 0

with v_i the velocity of the centre of mass, averaged over one stride and the next, and ahead the
unit vector midway between them, to the side where the head points: a is a mean force along the
course over the mass, and vanishes on a steady circle too. The derivative of U* is that of the root,
by the implicit function theorem,

    dU* = (U_theta - a_theta U_delta / a_delta) dtheta

where U and a are those of two strides after some that start from the steady state, made faster by
delta at their begin.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from slider_jax.beam.parameters import Numerics
from slider_jax.beam.state import to_body, to_plane
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import Carry, Snapshot, at_rest, with_motion
from slider_jax.dynamics.time_schemes import SDIRK2, Scheme


class SteadySettings(NamedTuple):
    """How a steady speed is sought."""

    settling: int = 6
    """Strides from the straight start until the gait has settled; also before derivatives."""
    between: int = 2
    """Strides from a change of speed to the last of those over which the next pace is taken."""
    corrections: int = 7
    second: float = 0.15
    """The speed [m/s] that is tried after the first."""
    largest: float = 0.3
    """Most that the speed is changed by at once [m/s]."""
    steps_per_stride: int = 96
    numerics: Numerics = Numerics(tail_cells=6, body_cells=24)
    scheme: Scheme = SDIRK2


STRIDES_BEFORE_START = 20.0
"""Strides that the drive is taken to have run before: longer than any delay of the valves."""


class MeanMotion(eqx.Module):
    """A swimmer over two strides."""

    course: Float[Array, "2"]
    """Unit vector along its mean velocity, to the side where the head points."""
    speed: Float[Array, ""]
    """[m/s]; negative tail first."""
    acceleration: Float[Array, ""]
    """Mean along the course [m/s^2]."""


class Steady(eqx.Module):
    """Where a search ended."""

    pace: MeanMotion
    """Of the last two strides."""
    missing: Float[Array, ""]
    """What the secant would still add to the speed [m/s]: small if the speed is steady."""
    carry: Carry
    """The state after the last stride."""
    ok: Bool[Array, ""]
    """Whether every step converged, and the search with them.

    Steady is a speed that changes by less than 0.2 % in a stride, and that the secant would change
    by less than 2 % more.
    """

    @property
    def speed(self) -> Float[Array, ""]:
        """[m/s]"""
        return self.pace.speed


def with_added_velocity(carry: Carry, change: Float[Array, "2"]) -> Carry:
    """The same with the velocity `change` (x, y) [m/s] added to every point's."""

    def add(motion):
        """(..., 3, nodes): V_tau, V_n, phi."""
        along, across = to_body(change, motion[..., 2, :])
        return motion.at[..., 0, :].add(along).at[..., 1, :].add(across)

    return with_motion(carry, add)


def stride_times(frequency, count: int, search: SteadySettings) -> TimeGrid:
    """`count` strides, as if the drive had long begun: every stride has a whole period of it."""
    h = 1.0 / (frequency * search.steps_per_stride)
    return TimeGrid(h, count * search.steps_per_stride, STRIDES_BEFORE_START / frequency)


def velocity(x: Snapshot) -> Float[Array, "2"]:
    """(x, y) [m/s] of the centre of mass."""
    cell, grid = x.section(), x.mesh.grid
    P = cell.linear_density * jnp.stack(to_plane(cell.V_tau, cell.V_n, cell.phi))
    return grid.integral(P) / grid.integral(cell.linear_density)


def velocity_and_heading(x: Snapshot) -> Float[Array, "2 2"]:
    """Velocity [m/s] of the centre of mass, and the body's mean direction, tail to head."""
    cell, grid = x.section(), x.mesh.grid
    ahead = jnp.stack(to_plane(jnp.ones_like(cell.phi), jnp.zeros_like(cell.phi), cell.phi))
    return jnp.stack([velocity(x), grid.integral(ahead)])


def mean_motion(before: Float[Array, "2"], mean, ahead, frequency) -> MeanMotion:
    """From the mean velocities of two strides, and where the head points [any length]."""
    both = 0.5 * (before + mean)
    size = jnp.sqrt(jnp.sum(both**2) + 1e-18)
    side = jnp.where(both @ ahead < 0.0, -1.0, 1.0)
    course = side * both / size
    return MeanMotion(course, side * size, (mean - before) @ course * frequency)


def simulate_strides(model: Model, frequency, carry: Carry, count: int, search: SteadySettings):
    """`count` strides more, two at least, of `frequency` [Hz]: the carry, the last two's pace."""
    times = stride_times(frequency, 1, search)

    def body(state, _):
        carry, (_, last), _ = state
        run = rollout(
            model,
            times,
            velocity_and_heading,
            search.numerics,
            search.scheme,
            begin=carry,
            checkpoint=False,
        )
        mean, ahead = jnp.mean(run.saved, axis=0)
        return (run.final, (last, mean), ahead), None

    nothing = jnp.zeros(2)
    begin = (carry, (nothing, nothing), nothing)
    (carry, (before, mean), ahead), _ = jax.lax.scan(body, begin, None, length=count)
    return carry, mean_motion(before, mean, ahead, frequency)


def find_steady(model: Model, frequency, search: SteadySettings = SteadySettings()) -> Steady:
    """Swim from rest and seek the steady speed; pure, to be batched by vmap.

    The model's support is to be `Free`. Not differentiable to any use: see `steady_speed`.
    """

    def correct(state, _):
        carry, pace, slope, change = state
        faster = with_added_velocity(carry, change * pace.course)
        carry, after = simulate_strides(model, frequency, faster, search.between + 1, search)
        far = after.speed - pace.speed
        secant = (after.acceleration - pace.acceleration) / jnp.where(far == 0.0, 1.0, far)
        # At rounding errors, and where it would lead away, the last one holds.
        slope = jnp.where((secant < 0.0) & (jnp.abs(far) > 1e-7), secant, slope)
        change = jnp.clip(-after.acceleration / slope, -search.largest, search.largest)
        return (carry, after, slope, change), None

    carry, pace = simulate_strides(
        model, frequency, at_rest(model, search.numerics), search.settling, search
    )
    begin = (carry, pace, jnp.asarray(-1.0), search.second - pace.speed)
    (carry, pace, _, change), _ = jax.lax.scan(correct, begin, None, length=search.corrections)
    size = jnp.abs(pace.speed) + 1e-6
    steady = jnp.abs(pace.acceleration) / frequency < 2e-3 * size
    return Steady(pace, change, carry, carry.ok & steady & (jnp.abs(change) < 0.02 * size))


def steady_speed(
    model: Model, frequency, search: SteadySettings = SteadySettings()
) -> Float[Array, ""]:
    """The steady speed [m/s], differentiable to model and frequency by the root's derivative.

    NaN where none is found.
    """
    held, f = jax.tree.map(jax.lax.stop_gradient, (model, frequency))
    found = jax.tree.map(jax.lax.stop_gradient, find_steady(held, f, search))
    course, change = found.pace.course, found.missing

    def goes_on(model, frequency, delta):
        begin = with_added_velocity(found.carry, (change + delta) * course)
        _, pace = simulate_strides(model, frequency, begin, search.settling, search)
        return pace.speed, pace.acceleration

    zero = jnp.zeros(())
    _, (speed_by, acceleration_by) = jax.jvp(lambda d: goes_on(held, f, d), (zero,), (zero + 1.0,))
    ratio = jax.lax.stop_gradient(speed_by / acceleration_by)
    speed, acceleration = goes_on(model, frequency, zero)
    return jnp.where(found.ok & jnp.isfinite(speed), speed - ratio * acceleration, jnp.nan)
