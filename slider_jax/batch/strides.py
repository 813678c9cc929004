"""Simulates a chunk of robots stride by stride and computes quantities of the steady strides.

The compiled program simulates one stride and is called for each stride. The caller can therefore
show progress and stop between strides.
"""

import functools as ft
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax import observables as obs
from slider_jax.beam.parameters import Numerics
from slider_jax.channels import SLIDER_CHANNELS, ChannelSet
from slider_jax.dynamics.model import Model, make_mesh
from slider_jax.dynamics.rollout import TimeGrid, continued
from slider_jax.dynamics.step import Carry, Snapshot, at_rest
from slider_jax.dynamics.time_schemes import SDIRK2, Scheme
from slider_jax.programs import compiled_once

POSES = 20
"""Number of midlines saved in the last stride."""


class StopRequested(Exception):
    """The caller stopped the run between strides."""


class BatchRobot(eqx.Module):
    """One robot of a batch, whose drive has the stride frequency `frequency` [Hz]."""

    model: Model
    frequency: Float[Array, ""]


class Plan(NamedTuple):
    """Settings of a run. All except `strides` are constant in the compiled programs."""

    steps_per_stride: int
    """Number of time steps per stride, a multiple of `POSES`."""
    strides: int
    numerics: Numerics
    scheme: Scheme = SDIRK2
    channels: ChannelSet = SLIDER_CHANNELS


def saved_quantities(channels: ChannelSet, x: Snapshot) -> dict[str, Array]:
    """Returns the saved quantities: true readings, `power` [W] and `midline` (2, nodes) [m]."""
    return channels.observe(x) | {
        "power": jnp.sum(obs.chamber_power(x)),
        "midline": obs.midline(x) - x.head[:, None],
    }


@compiled_once
def _rest(chunk: BatchRobot, numerics: Numerics) -> Carry:
    return jax.vmap(lambda robot: at_rest(robot.model, numerics))(chunk)


@compiled_once
def _stride(
    plan: Plan, chunk: BatchRobot, number: Array, carry: Carry
) -> tuple[Carry, dict[str, Array]]:
    """Simulates stride `number` (first: 0); returns the final carry and the series."""

    def one(robot: BatchRobot, carry: Carry):
        steps, f = plan.steps_per_stride, robot.frequency
        times = TimeGrid(h=1.0 / (f * steps), steps=steps, t0=number / f)
        save = ft.partial(saved_quantities, plan.channels)
        out = continued(carry, robot.model, times, save, plan.numerics, plan.scheme)
        return out.final, {"t": out.t} | out.saved

    return jax.vmap(one)(chunk, carry)


def run_strides(
    plan: Plan,
    chunk: BatchRobot,
    on_stride: Callable[[], None] = lambda: None,
    stopped: Callable[[], bool] = lambda: False,
) -> dict[str, np.ndarray]:
    """Returns the series of all strides of a chunk.

    `t`, `power` and all channels have the shape (robots, strides, steps). `midline` (robots, POSES,
    2, nodes) [m] contains midlines of the last stride. `ok` (robots,) is False if a robot's
    simulation failed. Raises `StopRequested` if `stopped()` is true between strides.
    """
    carry, series = _rest(chunk, plan.numerics), []
    shared = plan._replace(strides=0)  # all numbers of strides share a program
    for number in range(plan.strides):
        if stopped():
            raise StopRequested
        carry, saved = _stride(shared, chunk, jnp.asarray(float(number)), carry)
        midline = np.asarray(saved.pop("midline"))
        series.append({name: np.asarray(values) for name, values in saved.items()})
        on_stride()
    every = plan.steps_per_stride // POSES
    runs = {name: np.stack([x[name] for x in series], axis=1) for name in series[0]}
    runs["midline"] = midline[:, every - 1 :: every]
    runs["ok"] = np.asarray(carry.ok) & np.isfinite(runs["thrust"]).all(axis=(1, 2))
    return runs


def steady_quantities(
    plan: Plan, robots: BatchRobot, runs: dict[str, np.ndarray], transient: int
) -> dict[str, np.ndarray]:
    """Returns {name: values (robots,)} for the strides after the first `transient` strides.

    `thrust_std_of_strides` is the standard deviation of the strides' mean thrusts.
    `thrust_std_within_stride` is the mean of the standard deviations within each stride. Peaks and
    ranges are computed for each stride and then averaged. The wave quantities describe the motion
    at the drive frequency in the last stride. All quantities of a failed robot are NaN.
    """
    thrust, recoil, power, tip = (
        runs[name][:, transient:] for name in ("thrust", "recoil", "power", "tip")
    )
    per_stride = thrust.mean(axis=2)
    mean, mean_power = per_stride.mean(axis=1), power.mean(axis=(1, 2))
    waves, index = _waves(plan, robots, jnp.asarray(runs["midline"][:, :, 1]))
    table = {
        "thrust_mean_N": mean,
        "thrust_std_of_strides_N": per_stride.std(axis=1, ddof=min(1, per_stride.shape[1] - 1)),
        "thrust_std_within_stride_N": thrust.std(axis=2).mean(axis=1),
        "recoil_peak_N": np.abs(recoil).max(axis=2).mean(axis=1),
        "recoil_rms_N": np.sqrt((recoil**2).mean(axis=(1, 2))),
        "tip_half_range_m": 0.5 * np.ptp(tip, axis=2).mean(axis=1),
        "chamber_power_W": mean_power,
        "force_efficiency_N_per_W": mean / np.where(mean_power == 0.0, np.nan, mean_power),
        "body_wavelength_m": np.asarray(waves.wavelength),
        "wave_speed_m_per_s": np.asarray(waves.speed),
        "travelling_index": np.asarray(index),
    }
    return {name: np.where(runs["ok"], values, np.nan) for name, values in table.items()}


@ft.partial(jax.jit, static_argnums=0)
def _waves(plan: Plan, robots: BatchRobot, lateral):
    def wave(robot, y):
        t = jnp.arange(1.0, POSES + 1.0) / (POSES * robot.frequency)
        mode = obs.fundamental_mode(y, t, robot.frequency)
        s = make_mesh(robot.model.body, plan.numerics).grid.s
        return obs.body_wave(mode, s, robot.frequency), obs.travelling_index(mode)

    return jax.vmap(wave)(robots, lateral)
