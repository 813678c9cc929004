"""The climbing test: from hanging straight until strides repeat, and what they amount to."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.climbing.strides import (
    Climb,
    ClimbPlan,
    ClimbSeries,
    climb_from_rest,
    climb_of,
    climb_on,
    hanging,
    join,
)
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.step import Carry
from slider_jax.errors import SolverError
from slider_jax.experiment.load import Experiment, to_model, to_numerics
from slider_jax.experiment.schema import Trial
from slider_jax.simulation.sampling import half_period_steps
from slider_jax.swimming.gait import CAP, LINK, stride_frequency, to_climber

PHASES = 16
"""Phases of the pin that are tried where none is given."""
PERIODS = 5
"""Most strides after which a climb may repeat: lightly damped swings skip strides."""
REPEATS = 3e-2
"""Largest difference between rises of strides that repeat, of their mean."""
MESH, STEP = 31, 5e-3
"""Most nodes, and longest step [s], with which phases of the pin are compared."""


@dataclass(frozen=True)
class ClimbRun:
    """A trial's drive, climbed. Arrays are NumPy's."""

    trial: Trial
    plan: ClimbPlan
    pin_phase: float
    link: float
    """[m]"""
    cap: float
    """[Pa]"""
    tried: dict[float, float]
    """Speed [m/s] by pin phase, where the phase was sought; NaN where a step failed."""
    found: Climb
    """Over the last `plan.strides`, or as many of them as are whole periods."""
    series: Any
    """`ClimbSeries` of these, from the end of the step before them."""
    rises: np.ndarray
    """Of the head at every stride from the 16th on [m]."""
    period: int
    """Strides after which the last ones repeat; 0 where they do not."""

    @property
    def frequency(self) -> float:
        """Of the strides [Hz]."""
        return stride_frequency(self.trial)


@eqx.filter_jit
def _more(model: Model, frequency, carry: Carry, plan: ClimbPlan):
    return climb_on(model, frequency, carry, plan.strides, plan)


@eqx.filter_jit
def _amounts(model: Model, frequency, series: ClimbSeries, plan: ClimbPlan):
    return climb_of(model, frequency, series, plan)


def period_of(rises: np.ndarray, link: float, least: int = 10) -> int:
    """Strides after which the last `least` rises [m] repeat, up to `PERIODS`; 0 if they do not."""
    last = rises[-least - PERIODS :]
    same = REPEATS * max(np.abs(last).mean(), 0.1 * link)
    for n in range(1, PERIODS + 1):
        if len(last) >= least and np.abs(last[n:] - last[:-n]).max() < same:
            steady = all(np.ptp(last[i::n]) < same for i in range(n))  # nor does it drift
            return n if steady else 0
    return 0


def climb_plan(experiment: Experiment, frequency: float) -> ClimbPlan:
    """Mesh of the experiment, and an even number of steps to a stride, none longer than its."""
    numerics, scheme = to_numerics(experiment)
    steps = 2 * half_period_steps(frequency, experiment.numerics.step)
    return ClimbPlan(steps_per_stride=steps, numerics=numerics, scheme=scheme)


def speeds_by_phase(
    base: Model, frequency: float, link: float, cap: float, plan: ClimbPlan
) -> dict[float, float]:
    """Speed [m/s] with the pin at each of `PHASES` phases; NaN where a step fails."""

    @jax.jit
    def speeds(phases):
        def one(phase):
            model = to_climber(base, frequency, phase, None, link, cap)
            found, ok = climb_from_rest(model, frequency, plan)
            return jnp.where(ok, found.speed, jnp.nan)

        return jax.vmap(one)(phases)

    phases = np.arange(PHASES) / PHASES
    return dict(zip(phases.tolist(), np.asarray(speeds(phases)).tolist(), strict=True))


def _rough(experiment: Experiment, plan: ClimbPlan, frequency: float) -> ClimbPlan:
    """For comparing phases: up to `MESH` nodes, and steps of up to `STEP`."""
    nodes = min(MESH, experiment.numerics.nodes)
    numerics, _ = to_numerics(experiment.with_values({"numerics.nodes": nodes}))
    steps = min(plan.steps_per_stride, max(96, 2 * half_period_steps(frequency, STEP)))
    return plan._replace(numerics=numerics, steps_per_stride=steps)


def simulate_climb(
    experiment: Experiment,
    trial: Trial | int = 0,
    pin_phase: float | None = None,
    link: float = LINK,
    cap: float = CAP,
    progress: Callable[[str], None] = lambda text: None,
    longest: int = 150,
) -> ClimbRun:
    """Pin the robot to a wall in air, with the drive of a trial.

    It starts straight, its centre of mass below the pin, and goes on by 15 strides until they
    repeat or `longest` are done. What counts are the last 15, or as many whole periods of them
    as there are. Without a `pin_phase` the one of `PHASES` is taken with which it climbs fastest.
    Raises `InputError` for a recorded drive, and `SolverError` where a step does not converge.
    """
    if isinstance(trial, int):
        trial = experiment.trials[trial]
    frequency, base = stride_frequency(trial), to_model(experiment, trial)
    plan = climb_plan(experiment, frequency)
    tried: dict[float, float] = {}
    if pin_phase is None and trial.amplitude:
        progress(f"{PHASES} phases of the pin")
        rough = _rough(experiment, plan, frequency)
        tried = speeds_by_phase(base, frequency, link, cap, rough)
        if not np.isfinite(list(tried.values())).any():
            raise SolverError(
                f"{trial.file}: climbing: a step fails with every phase of the pin; a shorter "
                "numerics.step may help, or weaker pressures, or a --pin-phase of your own"
            )
        pin_phase = max(tried, key=lambda x: np.nan_to_num(tried[x], nan=-np.inf))
    pin_phase = pin_phase or 0.0
    model, f = (
        to_climber(base, frequency, pin_phase, None, link, cap),
        jnp.asarray(frequency, float),
    )
    progress("climbing")
    carry, before = _more(model, f, hanging(model, plan.numerics), plan)
    rises = np.empty(0)
    while True:
        carry, after = _more(model, f, carry, plan)
        if not bool(carry.ok):
            done = len(rises) + plan.strides
            raise SolverError(
                f"{trial.file}: climbing: a step did not converge within strides {done + 1} to "
                f"{done + plan.strides}; a shorter numerics.step may help, or weaker pressures"
            )
        series = join(before, after)
        found = _amounts(model, f, series, plan)
        rises, before = np.concatenate([rises, np.asarray(found.rises)]), after
        period = period_of(rises, link)
        if period or len(rises) + plan.strides >= longest:
            break
        progress(f"{len(rises) + plan.strides} strides")
    if period:
        whole = plan.strides // period * period
        series = jax.tree.map(lambda x: x[-whole * plan.steps_per_stride - 1 :], series)
        found = _amounts(model, f, series, plan)
    found, series = jax.device_get((found, series))
    return ClimbRun(trial, plan, pin_phase, link, cap, tried, found, series, rises, period)


UNITS = {
    "speed": "m_per_s",
    "drift": "m_per_s",
    "power": "W",
    "dissipated": "of_power",
    "stored": "of_power",
    "unaccounted": "of_power",
    "swing": "rad",
    "tail_swing": "m",
    "slip": "m_per_s",
}
"""Of quantities of `Climb`; the others have none."""


def climb_record(run: ClimbRun) -> dict[str, Any]:
    """What was found, in SI, by names with units."""
    table = {
        f"{name}_{UNITS[name]}" if name in UNITS else name: float(getattr(run.found, name))
        for name in (*UNITS, "efficiency")
    }
    return {
        "file": run.trial.file,
        "frequency_Hz": run.frequency,
        "pin_phase": run.pin_phase,
        "link_m": run.link,
        "cap_Pa": run.cap,
        **table,
        "strides": len(run.found.rises),
        "repeats_after_strides": run.period or None,
        "rise_of_strides_m": run.rises,
        "speed_by_pin_phase_m_per_s": {f"{x:g}": u for x, u in run.tried.items()} or None,
        "steps_per_stride": run.plan.steps_per_stride,
    }
