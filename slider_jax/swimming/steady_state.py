"""Finds the steady speed, at which the mean force along the course vanishes over a stride.

Shape, recoil and turning settle within a few strides, so time stepping computes them. The speed
U settles slowly, so a secant method finds the steady speed U* as the root of the acceleration a:

    a(U) = (v_2 - v_1) . course / T,    a(U*) = 0

v_1 and v_2 are the mean velocities of the centre of mass over two consecutive strides of period T.
The unit vector `course` is parallel to v_1 + v_2 and points towards the head. The acceleration a
also vanishes if the robot swims in a circle at constant speed. Each secant step adds its correction
to the velocity of the whole body and simulates `following` strides. The steps end when the next
correction is small. If a model parameter theta changes by dtheta, the implicit function theorem
gives the change of the steady speed:

    dU* = (U_theta - a_theta U_delta / a_delta) dtheta

Indices denote derivatives with respect to theta and to an added speed delta. A simulation of
`of_derivatives` strides from the steady state gives the derivatives: its last two strides give U
and a.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from slider_jax.beam.parameters import Numerics
from slider_jax.beam.state import to_body, to_plane
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.rollout import TimeGrid, continued
from slider_jax.dynamics.step import Carry, Snapshot, at_rest, with_motion
from slider_jax.dynamics.time_schemes import SDIRK2, Scheme


class SteadySettings(NamedTuple):
    """Settings of the root finding for the steady speed."""

    settling: int = 4
    """Number of strides from rest before the first correction."""
    of_derivatives: int = 6
    """Number of strides from the steady state that give the derivatives."""
    following: int = 2
    """Number of strides, at least 2, that follow each correction of the speed."""
    corrections: int = 8
    """Largest number of secant steps that strides follow. One more step follows at the end."""
    precision: float = 1e-3
    """The secant steps end before a correction below this fraction of the speed. The speed is
    therefore a function of the design with small jumps. A much smaller value needs more
    `corrections`."""
    second: float = 0.15
    """Second speed [m/s] of the secant method. The first is the speed after `settling` strides."""
    largest: float = 0.3
    """Largest change of the speed in one secant step [m/s]."""
    steps_per_stride: int = 96
    numerics: Numerics = Numerics(tail_cells=6, body_cells=24)
    scheme: Scheme = SDIRK2


LARGEST_GAIN = 2e-3
"""Largest change of a steady speed from one stride to the next, as a fraction of the speed."""
STRIDES_BEFORE_START = 20.0
"""Time from the start of the drive to the simulation, in strides; longer than any valve delay."""


class MeanMotion(eqx.Module):
    """Mean motion of a swimmer over two strides."""

    course: Float[Array, "2"]
    """Unit vector parallel to the mean velocity; the vector points towards the head."""
    speed: Float[Array, ""]
    """Mean speed [m/s]; negative if the tail leads."""
    acceleration: Float[Array, ""]
    """Mean acceleration along the course [m/s^2]."""


class Steady(eqx.Module):
    """Result of the root finding."""

    pace: MeanMotion
    """Mean motion of the last two strides, before the last secant step."""
    change: Float[Array, ""]
    """Change of the speed [m/s] in the last secant step; small if the speed is steady."""
    carry: Carry
    """The state after the last stride and the last secant step."""
    strides: Int[Array, ""]
    """Number of strides that the search simulated."""
    ok: Bool[Array, ""]
    """Whether every time step and the root finding converged.

    The root finding converged if the speed changes by less than `LARGEST_GAIN` per stride, and the
    last secant step is less than 2 % of the speed.
    """

    @property
    def speed(self) -> Float[Array, ""]:
        """Steady speed [m/s]."""
        return self.pace.speed + self.change


def with_added_velocity(carry: Carry, change: Float[Array, "2"]) -> Carry:
    """Returns the state with `change` (x, y) [m/s] added to the velocity of every point."""

    def add(motion):
        along, across = to_body(change, motion[..., 2, :])
        return motion.at[..., 0, :].add(along).at[..., 1, :].add(across)

    return with_motion(carry, add)


def stride_times(frequency, count: int, search: SteadySettings) -> TimeGrid:
    """Returns the time grid of `count` strides, which begins long after the start of the drive."""
    h = 1.0 / (frequency * search.steps_per_stride)
    return TimeGrid(h, count * search.steps_per_stride, STRIDES_BEFORE_START / frequency)


def velocity(x: Snapshot) -> Float[Array, "2"]:
    """Returns the velocity (x, y) [m/s] of the centre of mass."""
    cell, grid = x.section(), x.mesh.grid
    P = cell.linear_density * jnp.stack(to_plane(cell.V_tau, cell.V_n, cell.phi))
    return grid.integral(P) / grid.integral(cell.linear_density)


def velocity_and_heading(x: Snapshot) -> Float[Array, "2 2"]:
    """Returns velocity [m/s] of the centre of mass, and the mean direction from tail to head."""
    cell, grid = x.section(), x.mesh.grid
    ahead = jnp.stack(to_plane(jnp.ones_like(cell.phi), jnp.zeros_like(cell.phi), cell.phi))
    return jnp.stack([velocity(x), grid.integral(ahead)])


def mean_motion(before: Float[Array, "2"], mean, ahead, frequency) -> MeanMotion:
    """Returns the mean motion from two strides' mean velocities; `ahead` points to the head."""
    both = 0.5 * (before + mean)
    size = jnp.sqrt(jnp.sum(both**2) + 1e-18)
    side = jnp.where(both @ ahead < 0.0, -1.0, 1.0)
    course = side * both / size
    return MeanMotion(course, side * size, (mean - before) @ course * frequency)


def simulate_strides(model: Model, frequency, carry: Carry, count: int, search: SteadySettings):
    """Returns the state after `count` (at least 2) strides, and the last two strides' motion."""
    times = stride_times(frequency, 1, search)

    def body(state, _):
        carry, (_, last), _ = state
        run = continued(carry, model, times, velocity_and_heading, search.numerics, search.scheme)
        mean, ahead = jnp.mean(run.saved, axis=0)
        return (run.final, (last, mean), ahead), None

    begin = (carry, (jnp.zeros(2), jnp.zeros(2)), jnp.zeros(2))
    (carry, (before, mean), ahead), _ = jax.lax.scan(body, begin, None, length=count)
    return carry, mean_motion(before, mean, ahead, frequency)


def find_steady(model: Model, frequency, search: SteadySettings = SteadySettings()) -> Steady:
    """Returns the steady motion of a robot that starts from rest. Use vmap for several robots.

    The model's support must be `Free`. For derivatives use `steady_speed`. Raises `ValueError` if
    fewer than two strides follow a correction.
    """
    if search.following < 2:
        raise ValueError(
            f"SteadySettings.following: given {search.following}; allowed 2 or more, because the "
            "acceleration is the difference of two strides"
        )

    def is_steady(pace: MeanMotion, change, precision: float):
        size = jnp.abs(pace.speed) + 1e-6
        gain = jnp.abs(pace.acceleration) / frequency
        return (gain < LARGEST_GAIN * size) & (jnp.abs(change) < precision * size)

    def unfinished(state):
        steps, (carry, pace, _, change) = state
        unsteady = (steps == 0) | ~is_steady(pace, change, search.precision)
        return (steps < search.corrections) & carry.ok & unsteady

    def correct(state):
        steps, (carry, pace, slope, change) = state
        faster = with_added_velocity(carry, change * pace.course)
        carry, after = simulate_strides(model, frequency, faster, search.following, search)
        far = after.speed - pace.speed
        secant = (after.acceleration - pace.acceleration) / jnp.where(far == 0.0, 1.0, far)
        # The previous slope is kept if the new slope is rounding error or leads away from the root.
        slope = jnp.where((secant < 0.0) & (jnp.abs(far) > 1e-7), secant, slope)
        change = jnp.clip(-after.acceleration / slope, -search.largest, search.largest)
        return steps + 1, (carry, after, slope, change)

    rest = at_rest(model, search.numerics)
    carry, pace = simulate_strides(model, frequency, rest, search.settling, search)
    begin = (carry, pace, jnp.asarray(-1.0), search.second - pace.speed)
    steps, found = jax.lax.while_loop(unfinished, correct, (jnp.asarray(0), begin))
    carry, pace, _, change = found
    strides = search.settling + search.following * steps
    ok = carry.ok & is_steady(pace, change, 0.02)
    return Steady(pace, change, with_added_velocity(carry, change * pace.course), strides, ok)


def steady_speed(
    model: Model, frequency, search: SteadySettings = SteadySettings()
) -> Float[Array, ""]:
    """Returns the steady speed [m/s], or NaN if no steady speed is found.

    The implicit function theorem gives the derivatives with respect to model and frequency.
    """
    held, f = jax.tree.map(jax.lax.stop_gradient, (model, frequency))
    found = jax.tree.map(jax.lax.stop_gradient, find_steady(held, f, search))
    course = found.pace.course

    def goes_on(model, frequency, delta):
        begin = with_added_velocity(found.carry, delta * course)
        _, pace = simulate_strides(model, frequency, begin, search.of_derivatives, search)
        return pace.speed, pace.acceleration

    zero = jnp.zeros(())
    _, (speed_by, acceleration_by) = jax.jvp(lambda d: goes_on(held, f, d), (zero,), (zero + 1.0,))
    ratio = jax.lax.stop_gradient(speed_by / acceleration_by)
    speed, acceleration = goes_on(model, frequency, zero)
    return jnp.where(found.ok & jnp.isfinite(speed), speed - ratio * acceleration, jnp.nan)
