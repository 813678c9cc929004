"""Simulates the way of one robot from the water to the wall, and tells where it fails and why."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.dynamics.step import at_rest
from slider_jax.experiment.load import Experiment, to_numerics
from slider_jax.experiment.transition_table import TransitionTable
from slider_jax.supports.gripping import HOLDING, LOST
from slider_jax.transition.crossing import CrossingSettings, continue_crossing, to_crosser

BLOCK = 1.0
"""Duration [s] that is simulated at once."""
DRY = 1e-9
"""Wet fraction below which the robot is out of the water."""
STALLED = 2e-3
"""Speed [m/s] of the climb below which the robot does not climb: a tenth of the built-in climb."""
LAST = 5.0
"""Duration [s] at the end over which the failure is judged."""


@dataclass(frozen=True)
class CrossingRun:
    """Result of a way from the water to the wall, as NumPy arrays."""

    table: TransitionTable
    settings: CrossingSettings
    series: Any
    """`CrossingSeries` of all time steps until the goal, the end or the failed step."""
    ok: bool
    """Whether all time steps converged."""

    @property
    def times(self) -> np.ndarray:
        """Time [s] at the end of each time step."""
        return self.settings.step * np.arange(1.0, len(self.series.angle) + 1.0)

    def first(self, holds: np.ndarray) -> float | None:
        """Returns the first time [s] at which `holds` is true, or None."""
        return float(self.times[np.argmax(holds)]) if holds.any() else None

    @property
    def reached(self) -> float | None:
        """Time [s] at which the head reaches the goal; None if it does not, or if a step failed."""
        return None if not self.ok else self.first(self.series.head[:, 0] >= self.table.height)

    @property
    def gripped(self) -> float | None:
        """Time [s] of the first grip; None without a grip."""
        return self.first((self.series.status == HOLDING).any(axis=1))

    @property
    def left_water(self) -> float | None:
        """Time [s] from which on the robot is out of the water; None if it is wet at the end."""
        wet = np.nonzero(self.series.wet > DRY)[0]
        if len(wet) == 0:
            return 0.0
        return None if wet[-1] == len(self.times) - 1 else float(self.times[wet[-1] + 1])

    @property
    def pulled_off(self) -> int:
        """Number of grips that were lost."""
        lost = self.series.status == LOST
        return int(np.count_nonzero(lost[1:] & ~lost[:-1]))


_more = eqx.filter_jit(continue_crossing)


def crossing_settings(experiment: Experiment) -> CrossingSettings:
    """Returns the experiment's mesh, time step and scheme, in blocks of `BLOCK` seconds."""
    numerics, scheme = to_numerics(experiment)
    step = experiment.numerics.step
    return CrossingSettings(step, max(1, round(BLOCK / step)), numerics, scheme)


def simulate_transition(
    experiment: Experiment, progress: Callable[[int, int], None] = lambda done, total: None
) -> CrossingRun:
    """Simulates the table [transition] of an experiment until the goal, a failed step or the end.

    `progress(done, all)` receives the simulated time in blocks. Raises `InputError` as `to_crosser`
    does. A failed time step is a part of the result.
    """
    model, settings = to_crosser(experiment), crossing_settings(experiment)
    table = experiment.transition
    assert table is not None
    carry, parts = at_rest(model, settings.numerics), []
    span = settings.step * settings.block
    blocks = int(np.ceil(table.duration / span))
    for number in range(blocks):
        carry, part = _more(model, carry, jnp.asarray(number * span), settings)
        part = jax.device_get(part)
        parts.append(part)
        progress(number + 1, blocks)
        if not bool(carry.ok) or (part.head[:, 0] >= table.height).any():
            break
    series = jax.tree.map(lambda *x: np.concatenate(x), *parts)
    above = series.head[:, 0] >= table.height
    count = len(above)
    if not bool(carry.ok):
        count = max(1, int(float(carry.failed_at) / settings.step))
    elif above.any():
        count = int(np.argmax(above)) + 1
    return CrossingRun(table, settings, jax.tree.map(lambda x: x[:count], series), bool(carry.ok))


def outcome(run: CrossingRun) -> tuple[str, str]:
    """Returns the phase in which the robot ends, and a sentence about the success or the failure.

    The phases are "goal", "swimming", "gripping", "leaving the water" and "climbing".
    """
    x, table = run.series, run.table
    end = float(run.times[-1])
    highest = float(x.head[:, 0].max())
    if run.reached is not None:
        return "goal", f"the head is {table.height:g} m above the water after {run.reached:.2f} s"
    failed = "" if run.ok else f"a time step did not converge at {end:.3f} s; "
    last = min(LAST, 0.5 * end)
    recent = run.times > end - last
    first = int(np.argmax(recent))
    speed = float(x.head[-1, 0] - x.head[first, 0]) / last
    if run.gripped is None:
        below = max(0.0, table.wall_from - highest)
        turned = abs(float(x.angle[-1])) > 0.5 * np.pi
        why = "the robot turned away from the wall" if turned else "the robot was too slow"
        if below == 0.0:
            why = "no end of the cross-link was on the wall while it was commanded to grip"
        return "swimming", (
            f"{failed}no grip within {end:.1f} s: {why}; its head came to {below:.3f} m below the "
            "wall's edge"
        )
    holding = float((x.status[recent] == HOLDING).any(axis=1).mean())
    load = float(x.load.max())
    limit = table.spines.friction * table.spines.preload
    if run.pulled_off and holding < 0.5:
        return "gripping", (
            f"{failed}the wall was lost: {run.pulled_off} grips exceeded the pull-off force of "
            f"{table.spines.pull_off:g} N"
        )
    if holding < 0.5:
        return "gripping", (
            f"{failed}the robot left the wall's lower edge; the ends held it for "
            f"{100.0 * holding:.0f} % of the last {last:.1f} s"
        )
    phase = "leaving the water" if run.left_water is None else "climbing"
    slides = f"; the spines slip at {limit:g} N" if load > 0.98 * limit else ""
    if not speed > STALLED:
        pace = f"the robot does not climb ({1e3 * speed:.1f} mm/s in the last {last:.1f} s)"
    else:
        pace = f"the time is too short: the robot still climbs at {1e3 * speed:.1f} mm/s"
    wet = f"{100.0 * float(x.wet[-1]):.0f} % of the robot is wet"
    return phase, f"{failed}{pace}; its head is at {x.head[-1, 0]:.3f} m and {wet}{slides}"


def energies(run: CrossingRun) -> dict[str, float]:
    """Returns the work of the chambers [J] and its parts, after the first time step."""
    x, h = run.series, run.settings.step
    work, weight, water, body, spines = (
        float(np.trapezoid(v, dx=h))
        for v in (x.power, x.to_weight, x.to_water, x.to_body, x.to_spines)
    )
    stored = float(x.stored[-1] - x.stored[0])
    return {
        "work_J": work,
        "positive_work_J": float(np.trapezoid(np.maximum(x.power, 0.0), dx=h)),
        "to_weight_and_buoyancy_J": weight,
        "to_water_J": water,
        "to_body_J": body,
        "to_spines_J": spines,
        "stored_J": stored,
        "unaccounted_J": work - weight - water - body - spines - stored,
    }


def transition_record(run: CrossingRun) -> dict[str, Any]:
    """Returns the results for JSON in SI units; each name ends in its unit."""
    x = run.series
    phase, text = outcome(run)
    return {
        "outcome": phase,
        "reason": text,
        "time_to_grip_s": run.gripped,
        "time_to_leave_water_s": run.left_water,
        "time_to_goal_s": run.reached,
        "end_s": float(run.times[-1]),
        "height_at_end_m": float(x.head[-1, 0]),
        "highest_m": float(x.head[:, 0].max()),
        "wet_at_end": float(x.wet[-1]),
        "largest_load_N": float(x.load.max()),
        "grips_lost": run.pulled_off,
        "energy": energies(run),
        "steps_per_s": 1.0 / run.settings.step,
        "nodes": run.settings.numerics.nodes,
    }
