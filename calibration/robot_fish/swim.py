"""Simulates the swimming fish and returns the motion of its markers."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from calibration.robot_fish.fish import END, MARKER_X
from slider_jax.beam.parameters import Numerics, Scalar
from slider_jax.beam.state import node_positions
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import at_rest
from slider_jax.dynamics.time_schemes import SDIRK2
from slider_jax.swimming.steady_state import with_added_velocity


class SwimSettings(NamedTuple):
    """Numerical settings of a simulated swim."""

    numerics: Numerics = Numerics(tail_cells=9, body_cells=57)
    steps_per_beat: int = 64
    beats: int = 8
    kept: int = 3
    """Number of beats at the end from which speed and recoil are computed."""


class Swam(NamedTuple):
    """Simulated motion in the last beats."""

    t: Float[Array, " steps"]
    markers: Float[Array, "steps 9 2"]
    ok: Bool[Array, ""]


def swim_fish(
    model: Model, beat: Scalar, speed: Scalar, settings: SwimSettings = SwimSettings()
) -> Swam:
    """Simulates a fish that begins at the `speed` [m/s]. Use vmap for several fish."""
    numerics = settings.numerics
    begin = with_added_velocity(at_rest(model, numerics), jnp.stack([speed, 0.0 * speed]))
    times = TimeGrid.per_stride(beat, settings.steps_per_beat, settings.beats)

    def save(x):
        nodes = node_positions(x.y[5], x.memory.strain, x.memory.head, x.mesh.grid)
        at = END - MARKER_X
        return jnp.stack([jnp.interp(at, x.mesh.grid.s, nodes[k]) for k in (0, 1)], axis=-1)

    run = rollout(model, times, save, numerics, SDIRK2, begin=begin, checkpoint=False)
    last = settings.kept * settings.steps_per_beat
    return Swam(run.t[-last:], run.saved[-last:], run.ok)


swim_jit = eqx.filter_jit(swim_fish)
