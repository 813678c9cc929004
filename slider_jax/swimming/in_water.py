"""Simulates free swimming in moving water: a stream, a vortex street or a velocity field."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from slider_jax import observables as obs
from slider_jax.beam.state import to_body, to_plane
from slider_jax.dynamics.step import Snapshot, at_rest, with_motion
from slider_jax.errors import SolverError
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.prepare import prepare
from slider_jax.experiment.schema import Trial
from slider_jax.simulation.trial import CHUNK, advance_chunk, run_chunks
from slider_jax.supports import Free


@dataclass(frozen=True)
class SwimPath:
    """Motion of a free swimmer after each step, as NumPy arrays; vectors are (x, y)."""

    t: np.ndarray
    """Times (steps,) [s]."""
    midline: np.ndarray
    """Positions (steps, 2, nodes) [m] of the nodes, tail first."""
    velocity: np.ndarray
    """Velocity (steps, 2) [m/s] of the centre of mass."""
    water: np.ndarray
    """Velocity (steps, 2) [m/s] of the water, averaged along the body."""
    power: np.ndarray
    """Power (steps,) [W] of the chambers on the body."""

    @property
    def head(self) -> np.ndarray:
        """Positions (steps, 2) [m] of the head."""
        return self.midline[:, :, -1]


def _observed(x: Snapshot) -> dict[str, jax.Array]:
    at, integral = x.section(), x.mesh.grid.integral
    mass, length = at.linear_density, integral(jnp.ones_like(at.ds))
    V = jnp.stack(to_plane(at.V_tau, at.V_n, at.phi))
    U = V - jnp.stack(to_plane(at.u_tau, at.u_n, at.phi))
    return {
        "midline": obs.midline(x),
        "velocity": integral(mass * V) / integral(mass),
        "water": integral(U) / length,
        "power": jnp.sum(obs.chamber_power(x)),
    }


def swim_in_water(
    experiment: Experiment, trial: Trial | int = 0, velocity: tuple[float, float] = (0.0, 0.0)
) -> SwimPath:
    """Simulates a free robot with a trial's drive in the water of the experiment.

    At the start, the body is straight along x with its head at the origin, and moves with
    `velocity` (x, y) [m/s]. The simulation ends after the trial's duration; towing and heaving are
    ignored. Raises `InputError` for invalid files, and `SolverError` if a time step does not
    converge, for example because the robot left the grid of the water's velocity.
    """
    prepared = prepare(experiment, trial)
    model, numerics, grid = prepared.model, prepared.numerics, prepared.grid
    model = replace(model, support=Free())
    V_tau, V_n = to_body(velocity, jnp.zeros(()))
    start = jnp.stack([V_tau, V_n, 0.0 * V_tau])[:, None]
    carry = with_motion(at_rest(model, numerics), lambda rows: rows + start)
    h = jnp.asarray(grid.h)

    def advance(done: int, carry):
        t0 = jnp.asarray(grid.h * done)
        return advance_chunk(model, h, t0, carry, _observed, numerics, prepared.scheme, CHUNK)

    def after(done: int, saved, carry) -> None:
        failed = float(carry.failed_at)
        if failed < grid.h * (grid.steps + 0.5):
            raise SolverError(
                f"{prepared.trial.file}: the step to t = {failed:.6g} s did not converge; use a "
                "shorter numerics.step, or a larger field if the robot left the field of the water"
            )

    parts, _ = run_chunks(advance, carry, grid.steps, CHUNK, after)
    series = {
        name: np.concatenate([part[name] for part in parts])[: grid.steps] for name in parts[0]
    }
    return SwimPath(t=grid.times[1:], **series)
