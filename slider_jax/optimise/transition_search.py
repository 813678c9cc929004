"""Optimises the way from the water to the wall: a gait to swim, a gait to climb, and one tail.

The score is the mean speed of the head from the start to the goal. If the head does not reach the
goal in time, the score is the speed to its height at the end. The schedule has the swimming gait
until `switch`, and the climbing gait from `CHANGE` later on; all values are linear in between.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.rollout import TimeGrid, continued
from slider_jax.dynamics.step import at_rest
from slider_jax.experiment.load import Experiment, to_numerics
from slider_jax.swimming.gait import CAP
from slider_jax.transition.course import CourseSettings, GaitSchedule, to_crosser, with_schedule

CHANGE = 0.5
"""Duration [s] of the change from the swimming gait to the climbing gait: some strides."""
CROSSING_BOUNDS = {
    "swim_frequency": (1.0, 7.0),
    "swim_front": (50e3, 448e3),
    "swim_rear": (50e3, 448e3),
    "swim_phase": (-0.5, 0.5),
    "switch": (0.5, 10.0),
    "climb_frequency": (1.0, 4.0),
    "climb_front": (50e3, CAP),
    "climb_rear": (50e3, CAP),
    "climb_phase": (-0.5, 0.5),
    "grip_phase": (-0.5, 0.5),
    "tail_length": (0.020, 0.100),
    "EI_tail": (0.001, 0.038),
}
"""Bounds of the design variables in SI units: those of `slider optimize swim` and of the climber in
`slider optimize multimodal`, and an assumed range of the time of the switch."""


class CrossingTask(NamedTuple):
    """The experiment, the bounds (12,) and the numerical settings of an optimisation."""

    experiment: Experiment
    low: np.ndarray
    high: np.ndarray
    settings: CourseSettings
    blocks: int
    """Number of blocks of time steps until the end."""

    def values(self, unit: Float[Array, "12"]) -> dict[str, Scalar]:
        """Returns the design variables by name at a point of the unit box."""
        x = self.low + unit * (self.high - self.low)
        return {name: x[i] for i, name in enumerate(CROSSING_BOUNDS)}


def schedule_from(x: dict[str, Scalar]) -> GaitSchedule:
    """Returns the schedule (three knots) of the design variables."""

    def knots(swim, climb):
        return jnp.stack([jnp.asarray(v, float) for v in (swim, swim, climb)])

    switch = jnp.asarray(x["switch"], float)
    zero = jnp.zeros(3)
    return GaitSchedule(
        jnp.stack([jnp.zeros(()), switch, switch + CHANGE]),
        *(knots(x[f"swim_{k}"], x[f"climb_{k}"]) for k in ("frequency", "front", "rear", "phase")),
        zero,
        zero + x["grip_phase"],
    )


def crosser_of(base: Model, x: dict[str, Scalar]) -> Model:
    """Returns the model of a design; `base` is the model from `to_crosser`."""
    robot = base.robot.with_tail(x["tail_length"], x["EI_tail"])
    return with_schedule(eqx.tree_at(lambda m: m.robot, base, robot), schedule_from(x))


def crossing_speed(task: CrossingTask) -> Callable[[Float[Array, "12"]], Float[Array, ""]]:
    """Returns the score [m/s] of a point of the unit box; NaN if a time step fails."""
    table = task.experiment.transition
    assert table is not None
    base, settings = to_crosser(task.experiment), task.settings
    way = table.depth + table.height
    span = settings.step * settings.block

    def speed(unit):
        model = crosser_of(base, task.values(unit))

        def block(state):
            number, carry, _ = state
            times = TimeGrid(settings.step, settings.block, number * span)
            run = continued(
                carry, model, times, lambda x: x.head[0], settings.numerics, settings.scheme
            )
            above = run.saved >= way
            first = times.times[jnp.argmax(above)]
            return number + 1.0, run.final, jnp.where(jnp.any(above), first, jnp.inf)

        def unfinished(state):
            number, carry, arrival = state
            return (number < task.blocks) & carry.ok & jnp.isinf(arrival)

        begin = jnp.zeros(()), at_rest(model, settings.numerics), jnp.asarray(jnp.inf)
        number, carry, arrival = jax.lax.while_loop(unfinished, block, begin)
        reached = way / arrival
        short = carry.memory.head[0] / (task.blocks * span)
        return jnp.where(carry.ok, jnp.where(jnp.isinf(arrival), short, reached), jnp.nan)

    return speed


def crossing_task(experiment: Experiment, bounds: dict[str, tuple[float, float]]) -> CrossingTask:
    """Returns the task of an experiment; `bounds` replace bounds of `CROSSING_BOUNDS`."""
    table = experiment.transition
    to_crosser(experiment)
    assert table is not None
    low, high = np.array(list((CROSSING_BOUNDS | bounds).values())).T
    numerics, scheme = to_numerics(experiment)
    block = round(1.0 / experiment.numerics.step)
    settings = CourseSettings(experiment.numerics.step, block, numerics, scheme)
    span = settings.step * settings.block
    return CrossingTask(experiment, low, high, settings, int(np.ceil(table.duration / span)))
