"""What a swimmer does over a stride: the rows of the paper's table, and what they are made of."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from slider_jax import observables as obs
from slider_jax.batch.strides import Member, Plan
from slider_jax.beam.parameters import G, Scalar
from slider_jax.beam.state import to_plane
from slider_jax.dynamics.model import Model, make_mesh
from slider_jax.dynamics.rollout import rollout
from slider_jax.dynamics.step import Carry, Snapshot
from slider_jax.effects import total_force
from slider_jax.swimming.steady_state import (
    SteadySettings,
    find_steady,
    mean_motion,
    stride_times,
    velocity_and_heading,
)


class Stride(eqx.Module):
    """One stride of a swimmer, at the end of each of its steps."""

    t: Float[Array, " steps"]
    """[s], from the begin of the stride before."""
    midline: Float[Array, "steps 2 nodes"]
    """[m], tail first, in the plane."""
    velocity: Float[Array, "steps 2"]
    """Of the centre of mass [m/s]."""
    resistance: Float[Array, "steps 2"]
    """Force of the effects that resist motion along the body [N]."""
    power: Float[Array, " steps"]
    """Of the chambers on the body [W]."""
    velocity_before: Float[Array, "2"]
    """Mean over the stride before [m/s]."""
    ahead: Float[Array, "2"]
    """Where the head points: the body's mean direction, of any length."""
    ok: Bool[Array, ""]
    """Whether every step converged."""


class Performance(eqx.Module):
    """Scalars, over one stride. Lengths across are to the course."""

    speed: Scalar
    """U [m/s], of the centre of mass along its course; negative tail first."""
    wavelength: Scalar
    """lambda [m], of the body wave."""
    wave_speed: Scalar
    """V = lambda f [m/s]."""
    travelling_index: Scalar
    """1 for a travelling wave, 0 for a standing one, of which lambda and V mean little."""
    power: Scalar
    """P [W], mean of the chambers on the body."""
    thrust: Scalar
    """T [N], mean along the course of what takes up the force of the effects that resist."""
    froude_efficiency: Scalar
    """T U / P [-]"""
    slender_efficiency: Scalar
    """(1 + U/V)/2 [-], of a slender body in an ideal fluid (Lighthill 1960)."""
    force_efficiency: Scalar
    """T / P [N/W]"""
    cost_of_transport: Scalar
    """P / (m g U) [-]"""
    tail_amplitude: Scalar
    """A_t [m], half of the tip's peak-to-peak excursion."""
    head_amplitude: Scalar
    """The same of the head [m]: the recoil of a body that nothing holds."""
    strouhal: Scalar
    """2 A_t f / U [-]"""
    tail_slope: Scalar
    """A_t / (lambda/4) [-]"""
    shape_wavelength: Scalar
    """[m], of the body's shape: also of a standing wave."""
    shape_tail_slope: Scalar
    """A_t over a quarter of it [-]."""
    turning: Scalar
    """Of the course [rad] per stride, to the left."""


def next_stride(model: Model, frequency, carry: Carry, search: SteadySettings) -> Stride:
    """The second of the two strides that follow `carry`."""

    def saved(x: Snapshot):
        cell, grid = x.section(), x.mesh.grid
        resisting = tuple(e for e in x.stage.effects if e.resists)
        F = jnp.stack(to_plane(*total_force(resisting, cell), cell.phi))
        resistance = grid.integral((1.0 + cell.strain) * F)
        return obs.midline(x), velocity_and_heading(x), resistance, jnp.sum(obs.chamber_power(x))

    steps = search.steps_per_stride
    times = stride_times(frequency, 2, search)
    run = rollout(
        model, times, saved, search.numerics, search.scheme, begin=carry, checkpoint=False
    )
    before = jnp.mean(run.saved[1][:steps, 0], axis=0)
    midline, moved, resistance, power = (x[steps:] for x in run.saved)
    ahead = jnp.mean(moved[:, 1], axis=0)
    return Stride(run.t[steps:], midline, moved[:, 0], resistance, power, before, ahead, run.ok)


def performance(model: Model, frequency, stride: Stride, search: SteadySettings) -> Performance:
    """What a steady stride amounts to."""
    mean, before = jnp.mean(stride.velocity, axis=0), stride.velocity_before
    pace = mean_motion(before, mean, stride.ahead, frequency)
    speed, along = pace.speed, pace.course
    # Left of the course is positive, as n is of tau.
    across = -along[1] * stride.midline[:, 0] + along[0] * stride.midline[:, 1]
    s = make_mesh(model.body, search.numerics).grid.s
    mode = obs.fundamental_mode(across, stride.t, frequency)
    wave = obs.body_wave(mode, s, frequency)
    shape_wavelength = obs.shape_wavelength(mode, s)
    half = 0.5 * (jnp.max(across, axis=0) - jnp.min(across, axis=0))
    power, thrust = jnp.mean(stride.power), -jnp.mean(stride.resistance, axis=0) @ along
    weight = G * model.body.linear_density * model.body.length
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
) -> tuple[Stride, Performance, Bool[Array, ""]]:
    """A steady stride, what it amounts to, and whether it was found and every step converged."""
    found = find_steady(model, frequency, search)
    stride = next_stride(model, frequency, found.carry, search)
    return stride, performance(model, frequency, stride, search), found.ok & stride.ok


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
"""Of quantities of `Performance`; the others have none."""


def performance_columns(found: Performance) -> dict[str, Scalar]:
    """Quantities by their names with units."""
    return {
        f"{name}_{UNITS[name]}" if name in UNITS else name: value
        for name, value in vars(found).items()
    }


def compile_swim(plan: Plan, chunk: Member) -> Callable[[Member], tuple[Performance, Array]]:
    """Compile for members stacked as in `chunk`: what their steady strides amount to, and ok."""
    search = SteadySettings(
        steps_per_stride=plan.steps_per_stride, numerics=plan.numerics, scheme=plan.scheme
    )

    def one(member):
        _, found, ok = steady_stride(member.model, member.frequency, search)
        return found, ok

    return jax.jit(jax.vmap(one)).lower(chunk).compile()


def performance_table(found: Performance, ok: Array) -> dict[str, np.ndarray]:
    """Quantities (members,) of steady strides, named with their units; NaN where not `ok`."""
    table = {name: np.asarray(values) for name, values in performance_columns(found).items()}
    return {name: np.where(ok, values, np.nan) for name, values in table.items()}
