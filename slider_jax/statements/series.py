"""Time series and shapes of a robot for the figures that repeat the paper's Figs. 5, 6 and 8."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from slider_jax import observables as obs
from slider_jax.dynamics.model import Model, make_mesh
from slider_jax.dynamics.rollout import TimeGrid, continued, rollout
from slider_jax.errors import SolverError
from slider_jax.reproduction.wavelengths import wavelengths
from slider_jax.statements.assumptions import Assumptions
from slider_jax.statements.quantities import FINE, TRANSIENT
from slider_jax.swimming.paper_optimum import PAPER_GAIT
from slider_jax.swimming.performance import next_stride
from slider_jax.swimming.steady_state import find_steady, stride_times


class StrideSeries(NamedTuple):
    """One steady stride, sampled at the end of each time step."""

    t: np.ndarray
    """Time (steps,) [s] from the start of the stride."""
    pressure: np.ndarray
    """Pressures (steps, 2) [Pa] of the front and the rear chamber."""
    tip: np.ndarray
    """Lateral position (steps,) [m] of the tip."""
    thrust: np.ndarray
    """Force (steps,) [N] on the clamp."""
    recoil: np.ndarray
    midline: np.ndarray
    """Positions (steps, 2, nodes) [m]."""
    force: np.ndarray
    """Force per length (steps, 2, cells) [N/m] of the water."""
    moment: np.ndarray
    """Active moment (steps, cells) [N m] of the chambers."""


def _saved(x):
    return (
        x.chambers.acting, obs.tip(x), obs.thrust(x), obs.recoil(x), obs.midline(x),
        x.force_density(), x.chambers.acting @ x.mesh.chambers,
    )  # fmt: skip


@eqx.filter_jit
def _clamped(model: Model, frequency, steps: int):
    times = TimeGrid(1.0 / (frequency * steps), steps * (TRANSIENT + 1), 0.0)
    search = FINE.search
    found = rollout(model, times, _saved, search.numerics, search.scheme, checkpoint=False)
    return [x[-steps:] for x in found.saved], found.ok


@eqx.filter_jit
def _swimming(model: Model, frequency):
    search = FINE.search
    steady = find_steady(model, frequency, search)
    times = stride_times(frequency, 1, search)
    found = continued(steady.carry, model, times, _saved, search.numerics, search.scheme)
    stride = next_stride(model, frequency, steady.carry, search)
    return found.saved, stride, found.ok & steady.ok & stride.ok


def head_fixed_stride(assumed: Assumptions, frequency: float) -> StrideSeries:
    """Returns the first steady stride with a clamped head. Raises `SolverError` if a step fails."""
    f = jnp.asarray(frequency)
    saved, ok = jax.device_get(_clamped(assumed.head_fixed(f), f, FINE.search.steps_per_stride))
    return _series(frequency, saved, ok, f"head fixed, {frequency:g} Hz")


def swimming_stride(assumed: Assumptions) -> tuple[StrideSeries, dict[str, float]]:
    """Returns a steady stride of the paper's optimum, and its wavelength [m] by each definition.

    Raises `SolverError` if no steady stride is found.
    """
    f = float(PAPER_GAIT.frequency)
    saved, stride, ok = jax.device_get(_swimming(assumed.swimmer(PAPER_GAIT), jnp.asarray(f)))
    series = _series(f, saved, ok, "swimming at the paper's optimum")
    robot = assumed.robot(PAPER_GAIT.tail_length, PAPER_GAIT.EI_tail)
    s = np.asarray(make_mesh(robot, FINE.search.numerics).grid.s)
    return series, wavelengths(stride, s, f)


def _series(frequency: float, saved, ok, what: str) -> StrideSeries:
    if not bool(ok):
        raise SolverError(f"{what}: a time step did not converge, or no steady speed was found")
    steps = len(saved[0])
    t = (np.arange(steps) + 1.0) / (steps * frequency)
    return StrideSeries(t, *(np.asarray(x) for x in saved))
