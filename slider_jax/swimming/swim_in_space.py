"""Simulates free swimming in three dimensions from rest, until strides repeat."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax import observables as obs
from slider_jax.beam.parameters import G
from slider_jax.beam.spatial import Vec
from slider_jax.dynamics.model import Model
from slider_jax.errors import SolverError
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.schema import Trial
from slider_jax.programs import compiled_once
from slider_jax.spatial.step import SpatialCarry, SpatialSnapshot, at_rest_in_space, spatial_rollout
from slider_jax.swimming.free_swim import REPEATS, free_swimmer, resisting, steady_settings
from slider_jax.swimming.gait import stride_frequency
from slider_jax.swimming.steady_state import SteadySettings, stride_times

LEAST, MOST = 20, 300
"""Least and largest number of strides from rest."""


class SpatialStride(eqx.Module):
    """One stride of a swimmer in space, sampled at the end of each time step."""

    midline: Float[Array, "steps 3 nodes"]
    """Midlines (x, y, z) [m], from tail to head."""
    velocity: Float[Array, "steps 3"]
    """Velocity (x, y, z) [m/s] of the centre of mass."""
    tau: Float[Array, "steps 3"]
    """Mean over the body of the axis tau, which points towards the head."""
    b: Float[Array, "steps 3"]
    """Mean over the body of the axis b, along which the section has its height."""
    tail_twist: Float[Array, " steps"]
    """Angle [rad] by which the tail's end is turned about tau relative to the tail's root."""
    power: Float[Array, " steps"]
    """Power [W] of the chambers on the body."""


class Attitude(eqx.Module):
    """Mean attitude of the body, from the means of tau and b. Yaw is undefined at pitch +-pi/2."""

    yaw: Array
    """Angle [rad] of tau, seen from above, to the x axis."""
    pitch: Array
    """Angle [rad] of tau above the horizontal plane."""
    roll: Array
    """Angle [rad] by which the body is turned about tau. Without roll, b is in a vertical plane."""


@dataclass(frozen=True)
class SwimInSpace:
    """Result of free swimming from rest in three dimensions, as NumPy arrays."""

    trial: Trial
    search: SteadySettings
    repeats: bool
    """Whether strides repeat at the end."""
    velocity: Float[np.ndarray, "strides 3"]
    """Mean velocity (x, y, z) [m/s] of the centre of mass in each stride."""
    attitude: Attitude
    """Mean attitude in each stride; every field has the shape (strides,)."""
    head: Float[np.ndarray, "strides 3"]
    """Position (x, y, z) [m] of the head at the end of each stride."""
    stride: SpatialStride
    """The last stride."""
    mass: float
    """Mass [kg] of the robot."""
    resisting: str
    """Names of the effects that resist motion along the body."""

    @property
    def frequency(self) -> float:
        """Stride frequency [Hz]."""
        return stride_frequency(self.trial)


def attitude_of(tau: Float[Array, "... 3"], b: Float[Array, "... 3"]) -> Attitude:
    """Returns the attitude of a body with the axes `tau` and `b`, which need not be unit vectors.

    The axis n' = z x tau is horizontal, and b' = tau x n'. The roll is the angle from b' to b.
    """
    x, y, z = jnp.moveaxis(tau, -1, 0)
    across = jnp.stack([-y, x, jnp.zeros_like(x)], axis=-1)
    level = jnp.sqrt(x * x + y * y)
    above = jnp.cross(tau, across) / jnp.sqrt(jnp.sum(tau * tau, -1, keepdims=True))
    return Attitude(
        yaw=jnp.arctan2(y, x),
        pitch=jnp.arctan2(z, level),
        roll=jnp.arctan2(-jnp.sum(b * across, -1), jnp.sum(b * above, -1)),
    )


@compiled_once
def _next_stride(
    model: Model, frequency: Array, carry: SpatialCarry, search: SteadySettings
) -> tuple[SpatialCarry, SpatialStride]:
    def saved(x: SpatialSnapshot) -> SpatialStride:
        cell, grid = x.section(), x.mesh.grid
        density, zero = cell.structure.linear_density, jnp.zeros_like(cell.strain)
        momentum = grid.integral(density * cell.frame.to_space(cell.V))
        length = grid.integral(1.0 + zero)

        def mean(axis: Vec) -> Array:
            return grid.integral(cell.frame.to_space(axis)) / length

        return SpatialStride(
            midline=x.positions(),
            velocity=momentum / grid.integral(density),
            tau=mean(Vec(1.0 + zero, zero, zero)),
            b=mean(Vec(zero, zero, 1.0 + zero)),
            tail_twist=-grid.integral(cell.structure.in_tail * cell.curvature.tau),
            power=x.actuator_power(),
        )

    times = stride_times(frequency, 1, search)
    run = spatial_rollout(
        model, times, saved, search.numerics, search.scheme, begin=carry, checkpoint=False
    )
    return run.final, run.saved


def simulate_swim_in_space(
    experiment: Experiment,
    trial: Trial | int = 0,
    progress: Callable[[int, int], None] = lambda done, most: None,
) -> SwimInSpace:
    """Simulates free swimming in three dimensions with a trial's drive, from rest.

    The body starts straight and horizontal, with the trial's `roll`. The simulation takes 20 to 300
    strides and ends early if strides repeat: from stride to stride, the mean velocity in the axes
    of the body changes by less than 1e-4 of the speed, and the rotation in a stride by less than
    1e-4 rad. With gravity, the angles of the axes to the vertical change by less than 1e-4 rad.
    `progress` is called with the number of strides done, and the largest number. Raises
    `InputError` for a recorded drive, and `SolverError` if a time step does not converge.
    """
    if isinstance(trial, int):
        trial = experiment.trials[trial]
    frequency, model = free_swimmer(experiment, trial)
    f, search = jnp.asarray(frequency, float), steady_settings(experiment, frequency)
    up = _upward(model)
    carry = at_rest_in_space(model, search.numerics)
    means: list[list[np.ndarray]] = []
    heads, repeats = [], False
    while not repeats and len(means) < MOST:
        carry, stride = _next_stride(model, f, carry, search)
        if not bool(carry.ok):
            at = len(means) / frequency
            raise SolverError(
                f"{trial.file}: a time step did not converge {at:.3g} s to {at + 1 / frequency:.3g}"
                " s after the start; use a shorter numerics.step, lower pressures or a stiffer tail"
            )
        stride = jax.tree.map(np.asarray, stride)
        means.append([x.mean(axis=0) for x in (stride.velocity, stride.tau, stride.b)])
        heads.append(stride.midline[-1, :, -1])
        repeats = len(means) >= LEAST and _alike(means[-3:], up)
        progress(len(means), MOST)
    velocity, tau, b = (np.array(x) for x in zip(*means, strict=True))
    attitude = jax.tree.map(np.asarray, attitude_of(jnp.asarray(tau), jnp.asarray(b)))
    return SwimInSpace(
        trial, search, repeats, velocity, attitude,
        np.array(heads), stride, float(model.body.mass), resisting(model),
    )  # fmt: skip


def _upward(model: Model) -> np.ndarray | None:
    """Returns the upward unit vector (x, y, z), or None if no effect depends on the vertical."""
    found = [effect.vertical() for effect in model.effects]
    total = sum((np.asarray(x) for x in found if x is not None), start=np.zeros(3))
    size = float(np.linalg.norm(total))
    return total / size if size > 0.0 else None


def _alike(means: list[list[np.ndarray]], up: np.ndarray | None) -> bool:
    """Returns whether the last of three strides repeats the stride before.

    `means` contains velocity, tau and b of each stride. Strides that repeat differ by a shift and a
    rotation; with the upward direction `up` of a weight, by a shift and a rotation about `up`.
    """
    axes, own = [], []
    for velocity, tau, b in means:
        n = np.cross(b, tau)
        axes.append(np.stack([x / np.linalg.norm(x) for x in (tau, n, np.cross(tau, n))]))
        own.append(axes[-1] @ velocity)
    speed = np.linalg.norm(own[-1]) + 1e-6
    turned = [after @ before.T for before, after in zip(axes, axes[1:], strict=False)]
    changes = [(own[-1] - own[-2]) / speed, turned[-1] - turned[-2]]
    if up is not None:
        changes.append((axes[-1] - axes[-2]) @ up)
    return bool(max(np.abs(x).max() for x in changes) < REPEATS)


def spatial_swim_record(swim: SwimInSpace) -> dict[str, Any]:
    """Returns the results for JSON in SI units; names of quantities end in the unit.

    The values describe the last stride. Excursions are half of the peak-to-peak values, relative to
    uniform motion: along n the mean plane of bending, and along b out of this plane.
    """
    f, stride = swim.frequency, swim.stride
    velocity, midline = swim.velocity[-1], np.asarray(stride.midline)
    yaw, pitch, roll = (np.unwrap(np.asarray(x)) for x in jax.tree.leaves(swim.attitude))
    speed = float(np.linalg.norm(velocity))
    tau, b = (np.asarray(x).mean(axis=0) for x in (stride.tau, stride.b))
    tau, b = tau / np.linalg.norm(tau), b / np.linalg.norm(b)
    along = float(np.copysign(speed, velocity @ tau))
    steps = len(stride.velocity)
    course = np.arange(1.0, steps + 1.0)[:, None] / (steps * f) * velocity
    place = midline - course[:, :, None]

    def excursion(axis: np.ndarray, node: int) -> float:
        return float(0.5 * np.ptp(place[:, :, node] @ axis))

    power = float(stride.power.mean())
    in_plane = excursion(np.cross(b, tau), 0)
    return {
        "file": swim.trial.file,
        "frequency_Hz": f,
        "steady": swim.repeats,
        "speed_m_per_s": along,
        "rising_m_per_s": float(velocity[2]),
        "roll_rad": float(np.arctan2(np.sin(roll[-1]), np.cos(roll[-1]))),
        "rolling_rad_per_s": float(roll[-1] - roll[-2]) * f,
        "pitch_rad": float(pitch[-1]),
        "turning_rad_per_s": float(yaw[-1] - yaw[-2]) * f,
        "power_W": power,
        "cost_of_transport": power / (swim.mass * G * speed) if speed > 0.0 else None,
        "tail_amplitude_m": in_plane,
        "tail_amplitude_out_of_plane_m": excursion(b, 0),
        "head_amplitude_m": excursion(np.cross(b, tau), -1),
        "head_amplitude_out_of_plane_m": excursion(b, -1),
        "tail_twist_rad": float(np.abs(stride.tail_twist).max()),
        "strouhal": float(obs.strouhal_number(f, 2.0 * in_plane, speed)) if speed > 0.0 else None,
        "from_rest": {
            "velocity_m_per_s": swim.velocity,
            "roll_rad": roll,
            "pitch_rad": pitch,
            "yaw_rad": yaw,
            "head_m": swim.head,
        },
        "steps_per_stride": swim.search.steps_per_stride,
    }
