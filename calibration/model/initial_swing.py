"""Computes how a trial's readings change if the robot still swings from the previous trial.

The drag is proportional to the squared speed. The amplitude of a small swing therefore decays
slowly, as 1/t with the time t. The swing has the shape of the first bending mode, approximated by
the deflection under a uniform load. The phase of the swing is unknown, so its position and speed at
the start are treated as noise. The experiment file declares the standard deviation of this noise.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from calibration.model.compiled import DIRECTIONS
from calibration.model.extended import Part, acting_part
from calibration.model.plan import TrialPlan
from calibration.model.tangents import initial_state_tangents
from slider_jax.beam.parameters import Numerics
from slider_jax.dynamics.model import Model, make_mesh
from slider_jax.dynamics.step import at_rest, with_motion
from slider_jax.effects import ReactiveForce
from slider_jax.experiment.load import Experiment


class SwingMode(NamedTuple):
    """Shape and frequency of the first bending mode, scaled to a tip displacement of 1 m."""

    angle: Float[Array, " nodes"]
    """Angle between the body and the x axis at each node [rad]."""
    place: Float[Array, " nodes"]
    """Lateral displacement of each node [m]."""
    frequency: Float[Array, ""]
    """Angular frequency of the mode [rad/s], from Rayleigh's quotient."""


def first_mode(model: Model, numerics: Numerics) -> SwingMode:
    """Returns the clamped body's first mode in water, from the shape under a uniform load."""
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
    """Returns tangents of the initial state, and the angular frequency [rad/s] of the first mode.

    The first two tangents are for the position and the speed of the swing; all others are zero.
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
    """Returns the changes (2, channels, samples) of the readings that an initial swing causes.

    The first change is due to an initial position, and the second change to an initial speed. Each
    is one standard deviation. The changes are linearised at the parameters `theta`. `size` is the
    standard deviation of the tip's position [m]. A value that is not finite, for example after a
    failed time step, becomes 0.
    """
    body = acting_part(p.extended, Part.BODY, theta)
    d_carry, frequency = _along(body.model, p.numerics)
    initial = np.zeros((DIRECTIONS, len(p.extended.channels)))
    initial[0, p.extended.channels.row("tip")] = 1.0
    changes = initial_state_tangents(p, theta, d_carry, initial)[:2]
    scale = np.array([size, size * float(frequency)])
    return np.nan_to_num(changes * scale[:, None, None], posinf=0.0, neginf=0.0)


def declared_swing_spans(
    experiment: Experiment, p: TrialPlan, theta: np.ndarray
) -> np.ndarray | None:
    """Returns `swing_spans` for the experiment's start swing, or None if the start swing is 0."""
    size = experiment.sensors.start_swing
    return swing_spans(p, theta, size) if size > 0.0 else None
