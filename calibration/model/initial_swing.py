"""The robot's residual swing at the start of a trial, treated as noise.

Drag that grows with the square of speed damps a small swing slowly: its amplitude falls as 1/t. A
trial therefore begins with some swing, of unknown phase. The swing has the shape of the first
bending mode, approximated by the deflection under a uniform load. Its two amplitudes, of position
and of speed, are noise of the size that the experiment declares. The model gives their effect on
each channel.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from calibration.model.predict import DIRECTIONS, TrialPlan, perturbed
from slider_jax.beam.parameters import Numerics
from slider_jax.channels import CHANNELS, row_of
from slider_jax.dynamics.model import Model, make_mesh
from slider_jax.dynamics.step import at_rest, with_motion
from slider_jax.effects import ReactiveForce
from slider_jax.experiment.load import Experiment


class Mode(NamedTuple):
    """The shape of a swing whose tip is 1 m to the left of straight."""

    angle: Float[Array, " nodes"]
    """[rad]"""
    place: Float[Array, " nodes"]
    """Lateral displacement [m]."""
    frequency: Float[Array, ""]
    """[rad/s], by Rayleigh's quotient."""


def first_mode(model: Model, numerics: Numerics) -> Mode:
    """The first mode of the clamped body in water: its deflection under a uniform load."""
    mesh = make_mesh(model.body, numerics)
    grid, structure = mesh.grid, mesh.structure
    curvature = grid.mid(grid.s) ** 2 / structure.EI

    def from_head(cells: Array) -> Array:
        behind = jnp.cumsum((cells * grid.ds)[::-1])[::-1]
        return -jnp.concatenate([behind, jnp.zeros(1)])

    angle = from_head(curvature)
    place = from_head(grid.mid(angle))
    stiffness = grid.integral(structure.EI * curvature**2)
    mass = structure.linear_density
    for effect in model.effects:
        if isinstance(effect, ReactiveForce):
            mass = mass + effect.m_a * effect.density * jnp.pi / 4.0 * structure.height**2
    inertia = grid.integral(mass * grid.mid(place) ** 2)
    size = place[0]
    return Mode(angle / size, place / size, jnp.sqrt(stiffness / inertia))


@eqx.filter_jit
def _along(model: Model, numerics: Numerics):
    """Tangents of the initial carry by place and speed, padded to `DIRECTIONS`; the frequency."""
    mode, carry = first_mode(model, numerics), at_rest(model, numerics)

    def initial(place, speed):
        def change(rows):
            moved = rows.at[..., 2, :].add(place * mode.angle)
            return moved.at[..., 1, :].add(speed * mode.place)

        return eqx.filter(with_motion(carry, change), eqx.is_inexact_array)

    zero, unit = jnp.zeros(()), jnp.eye(2, DIRECTIONS)
    along = jax.vmap(lambda d: jax.jvp(initial, (zero, zero), (d[0], d[1]))[1])(unit.T)
    return along, mode.frequency


def spans(p: TrialPlan, theta: np.ndarray, size: float) -> np.ndarray:
    """Changes (2, channels, samples) of the readings by the tip's initial position and speed.

    Each is one standard deviation of a swing of `size` [m], linearised about the trial at `theta`;
    0 where it is not finite, as after a step that failed.
    """
    d_carry, frequency = _along(p.extended.at(jnp.asarray(theta)), p.numerics)
    initial = np.zeros((DIRECTIONS, len(CHANNELS)))
    initial[0, row_of("tip")] = 1.0
    changes = perturbed(p, theta, d_carry, initial)[:2]
    scale = np.array([size, size * float(frequency)])
    return np.nan_to_num(changes * scale[:, None, None], posinf=0.0, neginf=0.0)


def declared_spans(experiment: Experiment, p: TrialPlan, theta: np.ndarray) -> np.ndarray | None:
    """`spans` of the swing that an experiment declares; None if it declares none."""
    size = experiment.sensors.start_swing
    return spans(p, theta, size) if size > 0.0 else None
