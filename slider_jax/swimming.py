"""Free swimming: the speed at which a driven body neither gains nor loses speed.

A body that nothing holds starts straight at a speed, swims some strides until its gait has settled,
and is watched for some more. Speed and acceleration are those of its centre of mass along its own
course, so lateral recoil, turning and surge within the stride are all free. Steady is the speed at
which the acceleration vanishes.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float
from scipy.optimize import brentq

from slider_jax.errors import SolverError
from slider_jax.frame import to_plane
from slider_jax.model import Model
from slider_jax.parameters import Numerics, grid_of
from slider_jax.pneumatics import start_chambers
from slider_jax.rollout import TimeGrid, rollout
from slider_jax.state import straight
from slider_jax.step import Snapshot, start
from slider_jax.supports import Free


class Plan(NamedTuple):
    """How a swimmer is watched."""

    settling: int = 4
    """Strides from the straight start until the gait has settled."""
    watched: int = 4
    """Strides over which speed and acceleration are taken; even."""
    steps_per_stride: int = 160
    numerics: Numerics = Numerics()


class Swim(eqx.Module):
    """A swimmer over its watched strides; scalars."""

    speed: Float[Array, ""]
    """[m/s]"""
    acceleration: Float[Array, ""]
    """[m/s^2]"""
    turning: Float[Array, ""]
    """Of the course [rad] per stride."""
    ok: Bool[Array, ""]


def velocity(x: Snapshot) -> Float[Array, "2"]:
    """(x, y) [m/s] of the centre of mass."""
    cell, grid = x.section(), x.mesh.grid
    P = cell.linear_density * jnp.stack(to_plane(cell.V_tau, cell.V_n, cell.phi))
    return grid.integral(P) / grid.integral(cell.linear_density)


def swim_from(model: Model, frequency, speed, strides: int, plan: Plan = Plan()):
    """Velocities (strides, 2) [m/s] of every stride from a straight start at `speed`, and ok.

    The model's support must be `Free`. A pure function, differentiable in model and speed.
    """
    s = grid_of(model.body, plan.numerics).s
    y, memory = straight(s, V_tau=speed)
    begin = start(y, memory, start_chambers(model))
    times = TimeGrid.per_stride(frequency, plan.steps_per_stride, strides)
    run = rollout(model, times, velocity, plan.numerics, begin=begin)
    return run.saved.reshape(strides, plan.steps_per_stride, 2).mean(axis=1), run.ok


def watch(model: Model, frequency, speed, plan: Plan = Plan()) -> Swim:
    """Speed and acceleration after a start at `speed` [m/s]; pure and differentiable."""
    by_stride, ok = swim_from(model, frequency, speed, plan.settling + plan.watched, plan)
    seen, half = by_stride[plan.settling :], plan.watched // 2
    early, late = (jnp.mean(v, axis=0) for v in (seen[:half], seen[half:]))
    course = early + late
    ahead = course / jnp.sqrt(jnp.sum(course**2) + 1e-18)
    turned = jnp.arctan2(early[0] * late[1] - early[1] * late[0], early @ late)
    return Swim(
        speed=0.5 * jnp.linalg.norm(course),
        acceleration=(late - early) @ ahead * frequency / half,
        turning=turned / half,
        ok=ok,
    )


class Steady(NamedTuple):
    """A steady speed, or none up to the fastest start."""

    speed: float | None
    """[m/s]; None where the swimmer still gains speed from `fastest`."""
    at_fastest: Swim
    """What it does from a start at the fastest speed."""


@eqx.filter_jit
def watched(model: Model, frequency, speed, plan: Plan = Plan()) -> Swim:
    """`watch`, compiled once for all models of one structure."""
    return watch(model, frequency, speed, plan)


def steady_speed(
    model: Model,
    frequency: float,
    plan: Plan = Plan(),
    fastest: float = 1.0,
    tolerance: float = 1e-4,
) -> Steady:
    """The speed [m/s] at which acceleration vanishes, by bracketing starts from 0 to `fastest`.

    `tolerance` [m/s] is that of the start. Raises `ValueError` where the support is not `Free` and
    `SolverError` where a rollout fails.
    """
    if not isinstance(model.support, Free):
        raise ValueError(f"support: given {type(model.support).__name__}; allowed Free")
    model = jax.tree.map(lambda x: jnp.asarray(x, float), model)
    seen: dict[float, Swim] = {}

    def acceleration(begin: float) -> float:
        found = watched(model, jnp.asarray(float(frequency)), jnp.asarray(float(begin)), plan)
        if not bool(found.ok):
            raise SolverError(
                f"swimming from {begin:g} m/s: a step did not converge; use more steps per stride "
                f"than {plan.steps_per_stride}"
            )
        seen[begin] = found
        return float(found.acceleration)

    if acceleration(fastest) > 0.0:
        return Steady(None, seen[fastest])
    if acceleration(0.0) <= 0.0:
        return Steady(float(seen[0.0].speed), seen[fastest])
    start_speed = brentq(acceleration, 0.0, fastest, xtol=tolerance)
    if start_speed not in seen:
        acceleration(start_speed)
    return Steady(float(seen[start_speed].speed), seen[fastest])
