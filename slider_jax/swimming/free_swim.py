"""Finds a free swimmer's steady speed by root finding, and by simulating swimming from rest."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.dynamics.model import Model
from slider_jax.dynamics.step import Carry, at_rest
from slider_jax.errors import SolverError
from slider_jax.experiment.load import Experiment, to_model, to_numerics
from slider_jax.experiment.prepare import half_period_steps
from slider_jax.experiment.schema import Trial
from slider_jax.programs import compiled_once
from slider_jax.swimming.gait import stride_frequency, to_swimmer
from slider_jax.swimming.performance import (
    Performance,
    Stride,
    next_stride,
    performance,
    performance_columns,
    steady_stride,
)
from slider_jax.swimming.steady_state import MeanMotion, SteadySettings, simulate_strides

AT_ONCE = 10
"""Number of strides between two checks of whether strides repeat."""
REPEATS = 1e-4
"""Strides repeat if the speed changes by less than this fraction from stride to stride."""


@dataclass(frozen=True)
class Swim:
    """Result of free swimming with a trial's drive, as NumPy arrays."""

    trial: Trial
    search: SteadySettings
    found: bool
    """Whether a steady speed was found."""
    strides: int
    """Number of strides that the search for the steady speed simulated."""
    performance: Performance
    """Performance over the steady stride, or over the last stride from rest if not `found`."""
    stride: Stride
    """The stride that `performance` describes."""
    from_rest: np.ndarray
    """Speed [m/s] after every tenth stride of the simulation from rest."""
    repeats: bool
    """Whether strides repeat at the end of the simulation from rest."""
    gaining: float
    """Mean acceleration [m/s^2] along the course at the end of the simulation from rest."""
    unresisted: np.ndarray | None
    """`from_rest` of the model without the effects `resisting`; None if `resisting` is empty."""
    unresisted_gaining: float
    """Mean acceleration [m/s^2] along the course at the end of `unresisted`; NaN without it."""
    resisting: str
    """Names of the effects that resist axial motion; the simulation `unresisted` omits them."""

    @property
    def frequency(self) -> float:
        """Stride frequency [Hz]."""
        return stride_frequency(self.trial)

    @property
    def difference(self) -> float:
        """Relative difference of the steady speed from the speed of the last stride from rest."""
        return float(self.performance.speed) / self.from_rest[-1] - 1.0


_steadily = compiled_once(steady_stride)


@compiled_once
def _some_strides(model: Model, frequency, carry: Carry, search: SteadySettings):
    return simulate_strides(model, frequency, carry, AT_ONCE, search)


@compiled_once
def _seen(model: Model, frequency, carry: Carry, search: SteadySettings):
    stride = next_stride(model, frequency, carry, search)
    return stride, performance(model, frequency, stride, search)


def _from_rest(
    model: Model, f: jax.Array, search: SteadySettings, least: int, most: int
) -> tuple[np.ndarray, MeanMotion, Carry, bool]:
    """Simulates swimming from rest.

    Returns the speed [m/s] after every tenth stride, the last motion, the final state, and whether
    strides repeat. The simulation takes `least` to `most` strides and ends early if strides
    repeat.
    """
    carry, speeds = at_rest(model, search.numerics), []
    while True:
        carry, pace = _some_strides(model, f, carry, search)
        if not bool(carry.ok):
            raise SolverError(
                f"swimming: a time step did not converge at {float(carry.failed_at):.4g} s of the "
                "drive; use a shorter numerics.step, lower pressures or a stiffer tail"
            )
        speeds.append(float(pace.speed))
        gained = abs(float(pace.acceleration)) / float(f)
        repeats = gained < REPEATS * (abs(speeds[-1]) + 1e-6) and len(speeds) > 1
        if len(speeds) * AT_ONCE >= least and (repeats or len(speeds) * AT_ONCE >= most):
            return np.array(speeds), pace, carry, repeats


def resisting(model: Model) -> str:
    """Returns the names of the effects that resist motion along the body."""
    return ", ".join(e.name() for e in model.effects if e.resists_axially)


def free_swimmer(experiment: Experiment, trial: Trial) -> tuple[float, Model]:
    """Returns a trial's frequency [Hz] and free robot. Raises `InputError` for an invalid trial."""
    return stride_frequency(trial), to_swimmer(to_model(experiment, trial))


def steady_settings(experiment: Experiment, frequency: float) -> SteadySettings:
    """Returns settings with the experiment's mesh and with steps of at most `numerics.step`."""
    numerics, scheme = to_numerics(experiment)
    steps = 2 * half_period_steps(frequency, experiment.numerics.step)
    return SteadySettings(
        precision=1e-5, corrections=14, steps_per_stride=steps, numerics=numerics, scheme=scheme
    )


def simulate_free_swim(
    experiment: Experiment,
    trial: Trial | int = 0,
    progress: Callable[[str], None] = lambda text: None,
    longest: int = 300,
) -> Swim:
    """Simulates free swimming with a trial's drive; towing and heaving are ignored.

    `longest` limits the number of strides from rest. Raises `InputError` for a recorded drive,
    and `SolverError` if a time step does not converge.
    """
    if isinstance(trial, int):
        trial = experiment.trials[trial]
    frequency, model = free_swimmer(experiment, trial)
    f, search = jnp.asarray(frequency, float), steady_settings(experiment, frequency)
    progress("finding the steady speed")
    stride, seen, ok, strides = _steadily(model, f, search)
    found = bool(ok)
    progress("swimming from rest")
    twelve = AT_ONCE * ceil(12.0 * frequency / AT_ONCE)  # number of strides in 12 s
    most = longest if found else min(longest, twelve)
    speeds, pace, carry, repeats = _from_rest(model, f, search, 2 * AT_ONCE, most)
    if not found:
        stride, seen = _seen(model, f, carry, search)
    own = tuple(e for e in model.effects if not e.resists_axially)
    unresisted, gaining = None, np.nan
    if len(own) < len(model.effects):
        progress(f"swimming from rest without {resisting(model)}")
        unresisted, bare, _, _ = _from_rest(replace(model, effects=own), f, search, twelve, twelve)
        gaining = float(bare.acceleration)
    seen, stride = jax.device_get((seen, stride))
    return Swim(
        trial, search, found, int(strides), seen, stride, speeds, repeats, float(pace.acceleration),
        unresisted, gaining, resisting(model),
    )  # fmt: skip


def swim_record(swim: Swim) -> dict[str, Any]:
    """Returns the results for JSON in SI units; names of quantities end in the unit."""
    return {
        "file": swim.trial.file,
        "frequency_Hz": swim.trial.frequency,
        "steady": swim.found,
        "strides_of_search": swim.strides,
        **{name: float(x) for name, x in performance_columns(swim.performance).items()},
        "from_rest": {
            "speed_m_per_s": swim.from_rest,
            "at_every_stride": AT_ONCE,
            "repeats": swim.repeats,
            "gaining_m_per_s2": swim.gaining,
        },
        "root_over_from_rest": 1.0 + swim.difference if swim.found else None,
        "without_resistance": None
        if swim.unresisted is None
        else {
            "effects": swim.resisting,
            "speed_m_per_s": swim.unresisted,
            "at_every_stride": AT_ONCE,
            "gaining_m_per_s2": swim.unresisted_gaining,
        },
        "steps_per_stride": swim.search.steps_per_stride,
    }
