"""Computes the performance of a swimmer over a stride: the quantities of the paper's table."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from slider_jax import observables as obs
from slider_jax.batch.strides import BatchRobot, Plan
from slider_jax.beam.parameters import G, Scalar
from slider_jax.beam.state import to_plane
from slider_jax.dynamics.model import Model, make_mesh
from slider_jax.dynamics.rollout import continued
from slider_jax.dynamics.step import Carry, Snapshot
from slider_jax.effects import total_force
from slider_jax.programs import compiled_once
from slider_jax.swimming.steady_state import (
    SteadySettings,
    find_steady,
    mean_motion,
    stride_times,
    velocity_and_heading,
)


class Stride(eqx.Module):
    """One stride of a swimmer, sampled at the end of each time step."""

    t: Float[Array, " steps"]
    """Time [s] of the drive."""
    midline: Float[Array, "steps 2 nodes"]
    """Midlines [m] in the plane, from tail to head."""
    velocity: Float[Array, "steps 2"]
    """Velocity of the centre of mass [m/s]."""
    resistance: Float[Array, "steps 2"]
    """Force [N] of the effects that resist motion along the body."""
    power: Float[Array, " steps"]
    """Power [W] of the chambers on the body."""
    velocity_before: Float[Array, "2"]
    """Mean velocity [m/s] of the centre of mass in the previous stride."""
    ahead: Float[Array, "2"]
    """Mean of the vector (x, y) [m] from the tail to the head."""
    ok: Bool[Array, ""]
    """Whether every step converged."""


class Performance(eqx.Module):
    """Quantities of one stride at frequency f. Amplitudes are perpendicular to the course."""

    speed: Scalar
    """Speed U [m/s] of the centre of mass along the course; negative if the tail leads."""
    wavelength: Scalar
    """Wavelength lambda [m] of the body wave."""
    wave_speed: Scalar
    """Speed V = lambda f [m/s] of the body wave."""
    travelling_index: Scalar
    """1 for a travelling wave; 0 for a standing wave, for which lambda and V have no meaning."""
    power: Scalar
    """Mean power P [W] of the chambers on the body."""
    thrust: Scalar
    """Mean thrust T [N]: minus the component of the mean `Stride.resistance` along the course."""
    froude_efficiency: Scalar
    """Froude efficiency T U/P [-]."""
    slender_efficiency: Scalar
    """Efficiency (1 + U/V)/2 [-] of a slender body in an ideal fluid (Lighthill 1960)."""
    force_efficiency: Scalar
    """Thrust divided by power, T/P [N/W]."""
    cost_of_transport: Scalar
    """Cost of transport P/(m g U) [-], with the weight m g of the robot."""
    tail_amplitude: Scalar
    """Tail amplitude A_t [m], half of the tip's peak-to-peak excursion."""
    head_amplitude: Scalar
    """Half of the head's peak-to-peak excursion [m]: the recoil of the free body."""
    strouhal: Scalar
    """Strouhal number 2 A_t f/U [-]."""
    tail_slope: Scalar
    """Tail slope A_t/(lambda/4) [-]."""
    shape_wavelength: Scalar
    """Wavelength [m] of the body's shape, which is also defined for a standing wave."""
    shape_tail_slope: Scalar
    """Tail slope A_t/(shape_wavelength/4) [-]."""
    turning: Scalar
    """Angle [rad] by which the course turns in one stride, positive to the left."""


def next_stride(model: Model, frequency, carry: Carry, search: SteadySettings) -> Stride:
    """Returns the second of the two strides that follow `carry`."""

    def saved(x: Snapshot):
        cell, grid = x.section(), x.mesh.grid
        resisting = tuple(e for e in x.stage.effects if e.resists_axially)
        F = jnp.stack(to_plane(*total_force(resisting, cell), cell.phi))
        resistance = grid.integral((1.0 + cell.strain) * F)
        return obs.midline(x), velocity_and_heading(x), resistance, jnp.sum(obs.chamber_power(x))

    steps, times = search.steps_per_stride, stride_times(frequency, 2, search)
    run = continued(carry, model, times, saved, search.numerics, search.scheme)
    before = jnp.mean(run.saved[1][:steps, 0], axis=0)
    midline, moved, resistance, power = (x[steps:] for x in run.saved)
    ahead = jnp.mean(moved[:, 1], axis=0)
    return Stride(run.t[steps:], midline, moved[:, 0], resistance, power, before, ahead, run.ok)


def performance(model: Model, frequency, stride: Stride, search: SteadySettings) -> Performance:
    """Returns the performance of a steady stride."""
    mean, before = jnp.mean(stride.velocity, axis=0), stride.velocity_before
    pace = mean_motion(before, mean, stride.ahead, frequency)
    speed, along = pace.speed, pace.course
    # Positions left of the course are positive, because n is also left of tau.
    across = -along[1] * stride.midline[:, 0] + along[0] * stride.midline[:, 1]
    s = make_mesh(model.body, search.numerics).grid.s
    mode = obs.fundamental_mode(across, stride.t, frequency)
    wave = obs.body_wave(mode, s, frequency)
    shape_wavelength = obs.shape_wavelength(mode, s)
    half = 0.5 * (jnp.max(across, axis=0) - jnp.min(across, axis=0))
    power, thrust = jnp.mean(stride.power), -jnp.mean(stride.resistance, axis=0) @ along
    weight = G * model.body.mass
    return Performance(
        speed=speed,
        wavelength=wave.wavelength,
        wave_speed=wave.speed,
        travelling_index=obs.travelling_index(mode),
        power=power,
        thrust=thrust,
        froude_efficiency=obs.froude_efficiency(thrust, speed, power),
        slender_efficiency=0.5 * (1.0 + speed / wave.speed),
        force_efficiency=obs.force_efficiency(thrust, power),
        cost_of_transport=power / (weight * jnp.abs(speed)),
        tail_amplitude=half[0],
        head_amplitude=half[-1],
        strouhal=obs.strouhal_number(frequency, 2.0 * half[0], jnp.abs(speed)),
        tail_slope=obs.tail_slope(half[0], wave.wavelength),
        shape_wavelength=shape_wavelength,
        shape_tail_slope=obs.tail_slope(half[0], shape_wavelength),
        turning=jnp.arctan2(before[0] * mean[1] - before[1] * mean[0], before @ mean),
    )


def steady_stride(
    model: Model, frequency, search: SteadySettings
) -> tuple[Stride, Performance, Bool[Array, ""], Int[Array, ""]]:
    """Returns a stride at the steady speed, its performance, and whether both are valid.

    The last value is the number of strides that the search for the steady speed simulated.
    """
    steady = find_steady(model, frequency, search)
    stride = next_stride(model, frequency, steady.carry, search)
    seen = performance(model, frequency, stride, search)
    return stride, seen, steady.ok & stride.ok, steady.strides


UNITS = {
    "speed": "m_per_s",
    "wavelength": "m",
    "wave_speed": "m_per_s",
    "power": "W",
    "thrust": "N",
    "force_efficiency": "N_per_W",
    "tail_amplitude": "m",
    "head_amplitude": "m",
    "shape_wavelength": "m",
    "turning": "rad_per_stride",
}
"""Units of the fields of `Performance`; the other fields are dimensionless."""


def names_with_units(values: dict[str, Any], units: dict[str, str]) -> dict[str, Any]:
    """Returns `values`, with the unit appended to each name that is in `units`."""
    return {f"{k}_{units[k]}" if k in units else k: value for k, value in values.items()}


def performance_columns(found: Performance) -> dict[str, Scalar]:
    """Returns the fields of `found` by name; the names of dimensional fields end in the unit."""
    return names_with_units(vars(found), UNITS)


@compiled_once
def swim_performance(plan: Plan, chunk: BatchRobot) -> tuple[Performance, Array]:
    """Returns (performance, ok) of the stacked robots of a chunk."""
    search = SteadySettings(
        steps_per_stride=plan.steps_per_stride, numerics=plan.numerics, scheme=plan.scheme
    )
    one = jax.vmap(lambda robot: steady_stride(robot.model, robot.frequency, search)[1:3])
    return one(chunk)


def performance_table(found: Performance, ok: Array) -> dict[str, np.ndarray]:
    """Returns one array (robots,) per field of `found`, with NaN for robots that are not `ok`."""
    columns = performance_columns(found)
    return {name: np.where(ok, np.asarray(values), np.nan) for name, values in columns.items()}
