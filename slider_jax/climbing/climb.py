"""Simulates the climbing test: a straight hanging robot starts and climbs until strides repeat."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

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
from slider_jax.experiment.drive import ratios_of
from slider_jax.experiment.load import Experiment, to_model, to_numerics
from slider_jax.experiment.prepare import half_period_steps
from slider_jax.experiment.schema import Trial
from slider_jax.programs import compiled_once
from slider_jax.swimming.free_swim import steady_settings
from slider_jax.swimming.gait import CAP, LINK, is_driven, stride_frequency, to_climber
from slider_jax.swimming.performance import names_with_units

PHASES = 16
"""Number of pin phases that are compared if no pin phase is given."""
PERIODS = 5
"""Longest period [strides] of a motion that repeats; lightly damped swings have long periods."""
REPEATS = 3e-2
"""Strides repeat if their rises differ by less than this fraction of the mean rise."""
MESH, STEP = 31, 5e-3
"""Largest number of nodes and longest time step [s] for the comparison of pin phases."""


@dataclass(frozen=True)
class ClimbRun:
    """Result of climbing with a trial's drive, as NumPy arrays."""

    trial: Trial
    plan: ClimbPlan
    pin_phase: float
    """Pin phase, as a fraction of a period."""
    link: float
    """Length of the cross-link [m]."""
    cap: float
    """Highest set pressure [Pa]."""
    set_pressures: dict[str, float]
    """Amplitude [Pa] of each chamber's set pressure, before the cap."""
    is_driven: bool
    """Whether a chamber or another actuator has a drive."""
    tried: dict[float, float]
    """Speed [m/s] at each compared pin phase; NaN if a step failed; empty if none is compared."""
    found: Climb
    """Performance in the last `plan.strides` strides; if strides repeat, in whole periods only."""
    series: Any
    """`ClimbSeries` of the strides in `found` and of the time step before these strides."""
    rises: np.ndarray
    """Rise of the head [m] in every stride from the 16th stride on."""
    period: int
    """Number of strides after which the last strides repeat; 0 if they do not repeat."""

    @property
    def frequency(self) -> float:
        """Stride frequency [Hz]."""
        return stride_frequency(self.trial)


@compiled_once
def _speeds(phases, base: Model, frequency, link, cap, plan: ClimbPlan):
    def speed(phase):
        model = to_climber(base, frequency, phase, None, link, cap)
        found, ok = climb_from_rest(model, frequency, plan)
        return jnp.where(ok, found.speed, jnp.nan)

    return jax.vmap(speed)(phases)


@compiled_once
def _more(model: Model, frequency, carry: Carry, plan: ClimbPlan):
    return climb_on(model, frequency, carry, plan.strides, plan)


@compiled_once
def _amounts(model: Model, frequency, series: ClimbSeries, plan: ClimbPlan):
    return climb_of(model, frequency, series, plan)


def period_of(rises: np.ndarray, link: float, least: int = 10) -> int:
    """Returns the number of strides (1 to `PERIODS`) after which `rises` [m] repeat, or 0.

    The result is 0 for fewer than `least` rises. `link` [m] is the cross-link's length.
    """
    last = rises[-least - PERIODS :]
    same = REPEATS * max(np.abs(last).mean(), 0.1 * link)
    for n in range(1, PERIODS + 1):
        if len(last) >= least and np.abs(last[n:] - last[:-n]).max() < same:
            steady = all(np.ptp(last[i::n]) < same for i in range(n))  # exclude a drift
            return n if steady else 0
    return 0


def climb_plan(experiment: Experiment, frequency: float) -> ClimbPlan:
    """Returns a plan with the experiment's mesh and an even number of steps in a stride."""
    settings = steady_settings(experiment, frequency)
    return ClimbPlan(
        steps_per_stride=settings.steps_per_stride,
        numerics=settings.numerics,
        scheme=settings.scheme,
    )


def speeds_by_phase(
    base: Model, frequency: float, link: float, cap: float, plan: ClimbPlan
) -> dict[float, float]:
    """Returns the speed [m/s] at each of `PHASES` pin phases; NaN if a time step fails."""
    phases = np.arange(PHASES) / PHASES
    given = map(jnp.asarray, (frequency, link, cap))
    speeds = np.asarray(_speeds(phases, base, *given, plan))
    return dict(zip(phases.tolist(), speeds.tolist(), strict=True))


def _rough(experiment: Experiment, plan: ClimbPlan, frequency: float) -> ClimbPlan:
    """Returns a coarser plan to compare pin phases: at most `MESH` nodes, steps up to `STEP`."""
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
    """Simulates climbing in air with a trial's drive.

    The robot starts straight with its centre of mass below the pin, and climbs in blocks of 15
    strides until strides repeat, or for `longest` strides. The result covers the last 15 strides.
    If strides repeat, only whole periods are covered. Without `pin_phase` (fraction of a period),
    the function uses the fastest of `PHASES` pin phases. `link` [m] is the cross-link's length, and
    `cap` [Pa] is the highest set pressure. Raises `InputError` for a recorded drive, and
    `SolverError` if a time step does not converge.
    """
    if isinstance(trial, int):
        trial = experiment.trials[trial]
    frequency, base = stride_frequency(trial), to_model(experiment, trial)
    plan = climb_plan(experiment, frequency)
    tried: dict[float, float] = {}
    driven = bool(is_driven(base))
    if pin_phase is None and driven:
        progress(f"comparing {PHASES} pin phases")
        rough = _rough(experiment, plan, frequency)
        tried = speeds_by_phase(base, frequency, link, cap, rough)
        if not np.isfinite(list(tried.values())).any():
            raise SolverError(
                f"{trial.file}: climbing: a time step fails for every pin phase; try a shorter "
                "numerics.step or lower pressures, or give --pin-phase"
            )
        pin_phase = max(tried, key=lambda x: np.nan_to_num(tried[x], nan=-np.inf))
    pin_phase = pin_phase or 0.0
    model = to_climber(base, frequency, pin_phase, None, link, cap)
    f = jnp.asarray(frequency, float)
    progress("climbing")
    carry, before = _more(model, f, hanging(model, plan.numerics), plan)
    rises = np.empty(0)
    while True:
        carry, after = _more(model, f, carry, plan)
        if not bool(carry.ok):
            done = len(rises) + plan.strides
            raise SolverError(
                f"{trial.file}: climbing: a time step did not converge in strides {done + 1} to "
                f"{done + plan.strides}; try a shorter numerics.step or lower pressures"
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
    names = experiment.chamber_names
    amplitudes = ((trial.amplitude or 0.0) * x for x in ratios_of(trial, len(names)))
    given = dict(zip(names, amplitudes, strict=True))
    return ClimbRun(
        trial, plan, pin_phase, link, cap, given, driven, tried, found, series, rises, period
    )


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
"""Units of the fields of `Climb`; the other fields are dimensionless."""


def climb_record(run: ClimbRun) -> dict[str, Any]:
    """Returns the results for JSON in SI units; each name ends in its unit."""
    values = {name: float(getattr(run.found, name)) for name in (*UNITS, "efficiency")}
    return {
        "file": run.trial.file,
        "frequency_Hz": run.frequency,
        "pin_phase": run.pin_phase,
        "link_m": run.link,
        "cap_Pa": run.cap,
        **names_with_units(values, UNITS),
        "strides": len(run.found.rises),
        "repeats_after_strides": run.period or None,
        "rise_of_strides_m": run.rises,
        "speed_by_pin_phase_m_per_s": {f"{x:g}": u for x, u in run.tried.items()} or None,
        "steps_per_stride": run.plan.steps_per_stride,
    }
