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

from calibration.model.predict import DIRECTIONS, TrialPlan, initial_state_tangents
from slider_jax.beam.parameters import Numerics
from slider_jax.channels import CHANNELS, row_of
from slider_jax.dynamics.model import Model, make_mesh
from slider_jax.dynamics.step import at_rest, with_motion
from slider_jax.effects import ReactiveForce
from slider_jax.experiment.load import Experiment


class SwingMode(NamedTuple):
    """Shape and frequency of the first mode; the tip's displacement is 1 m to the left."""

    angle: Float[Array, " nodes"]
    """[rad]"""
    place: Float[Array, " nodes"]
    """Lateral displacement [m]."""
    frequency: Float[Array, ""]
    """[rad/s], by Rayleigh's quotient."""


def first_mode(model: Model, numerics: Numerics) -> SwingMode:
    """Returns the clamped body's first mode in water, from its deflection under a uniform load."""
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
    return SwingMode(angle / size, place / size, jnp.sqrt(stiffness / inertia))


@eqx.filter_jit
def _along(model: Model, numerics: Numerics):
    """Returns the initial state's tangents along position and speed, and the mode's frequency.

    The tangents are padded to `DIRECTIONS`.
    """
    mode, carry = first_mode(model, numerics), at_rest(model, numerics)

    def initial(place, speed):
        def change(rows):
            moved = rows.at[..., 2, :].add(place * mode.angle)
            return moved.at[..., 1, :].add(speed * mode.place)

        return eqx.filter(with_motion(carry, change), eqx.is_inexact_array)

    zero, unit = jnp.zeros(()), jnp.eye(2, DIRECTIONS)
    along = jax.vmap(lambda d: jax.jvp(initial, (zero, zero), (d[0], d[1]))[1])(unit.T)
    return along, mode.frequency


def swing_spans(p: TrialPlan, theta: np.ndarray, size: float) -> np.ndarray:
    """Returns the readings' changes (2, channels, samples) by initial position and speed.

    Each change is for one standard deviation of a swing of `size` [m], linearised about the trial
    at `theta`. It is 0 if not finite, for example after a failed step.
    """
    d_carry, frequency = _along(p.extended.at(jnp.asarray(theta)), p.numerics)
    initial = np.zeros((DIRECTIONS, len(CHANNELS)))
    initial[0, row_of("tip")] = 1.0
    changes = initial_state_tangents(p, theta, d_carry, initial)[:2]
    scale = np.array([size, size * float(frequency)])
    return np.nan_to_num(changes * scale[:, None, None], posinf=0.0, neginf=0.0)


def declared_swing_spans(
    experiment: Experiment, p: TrialPlan, theta: np.ndarray
) -> np.ndarray | None:
    """Returns `swing_spans` for the swing that an experiment declares; None if it has none."""
    size = experiment.sensors.start_swing
    return swing_spans(p, theta, size) if size > 0.0 else None
