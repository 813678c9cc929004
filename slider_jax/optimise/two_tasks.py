"""Defines the objective for one tail that swims and climbs, with one drive for each task.

    eta(beta) = beta E_swim/E_swim,only + (1 - beta) E_climb/E_climb,only,    0 <= beta <= 1

beta is the weight of swimming. E_swim is the Froude efficiency of a steady stride. E_climb is m g
U/P over 15 strides, with the weight m g, the upward speed U and the power P of the chambers. The
index "only" marks the largest efficiency for one task alone. A design has two drives and one tail.
At beta = 0 or 1, one task has weight 0; its drive is optimised for the tail of the other task.
"""

from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.climbing.strides import ClimbPlan, climb_from_rest
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, to_model
from slider_jax.optimise.design_space import models
from slider_jax.optimise.fastest_swimmer import Task
from slider_jax.optimise.population import Evaluation, shared_by_folder
from slider_jax.swimming.gait import CAP, LINK, Gait, to_climber
from slider_jax.swimming.performance import steady_stride
from slider_jax.swimming.steady_state import SteadySettings

DRIVE = ("frequency", "front", "rear", "phase")
NAMES = (*DRIVE, *(f"climb_{name}" for name in DRIVE), "pin_phase", "tail_length", "EI_tail")
"""Design variables: drive of the swimmer (4), drive and pin phase of the climber (5), tail (2)."""
SWIM, CLIMB, TAIL = (0, 1, 2, 3), (4, 5, 6, 7, 8), (9, 10)
CLIMBER_BOUNDS = {
    "climb_frequency": (1.0, 4.0),
    "climb_front": (50e3, CAP),
    "climb_rear": (50e3, CAP),
    "climb_phase": (-0.5, 0.5),
    "pin_phase": (-0.5, 0.5),
}
"""Bounds of the climber's drive, in SI units. All bounds except `CAP` are assumed."""
UNACCOUNTED = 0.02
"""Largest error of a climb's energy balance, as a fraction of the power. If the error is larger,
the time step is too long, and the efficiency is NaN."""


class TwoTasks(NamedTuple):
    """The swimming task and the climbing task of one robot, and the bounds of the designs."""

    task: Task
    """The swimming task, with the bounds of the swimmer's drive and of the tail."""
    plan: ClimbPlan
    low: np.ndarray
    high: np.ndarray
    """Bounds (11,) of `NAMES`, in SI units."""

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        tail_length: tuple[float, float] | None = None,
        EI_tail: tuple[float, float] | None = None,
        steps_per_stride: int = 96,
    ) -> "TwoTasks":
        """Returns both tasks. Raises `InputError` for invalid bounds, drive or effects."""
        bounds = {"tail_length": tail_length, "EI_tail": EI_tail}
        task = Task.of(experiment, bounds, steps_per_stride)
        climbing = np.array(list(CLIMBER_BOUNDS.values())).T
        low, high = (
            np.concatenate([x[:4], y, x[4:]])
            for x, y in zip((task.box.low, task.box.high), climbing, strict=True)
        )
        # 10 settling strides, instead of ClimbPlan's default of 15, are enough to compare designs.
        steps = steps_per_stride + steps_per_stride // 3
        numerics, scheme = task.search.numerics, task.search.scheme
        plan = ClimbPlan(10, 15, steps + steps % 2, numerics, scheme)
        model = to_model(experiment, 0)
        to_climber(model, 1.0, 0.0)
        if not any(effect.resists_axially for effect in model.effects):
            raise InputError(
                "effects: no effect resists motion along the body, so a swimmer would be about ten "
                "times too fast; add an effect such as head_drag"
            )
        return cls(task, plan, low, high)

    def values(
        self, unit: np.ndarray | Float[Array, " n"], part: tuple[int, ...] = SWIM + CLIMB + TAIL
    ):
        """Returns SI values of the variables `part` at the point `unit` of the unit box."""
        low, high = self.low[list(part)], self.high[list(part)]
        return low + unit * (high - low)

    def gaits(self, unit: np.ndarray) -> tuple[Gait, Gait, float]:
        """Returns the swimming gait, the climbing gait and the pin phase of a design (11,)."""
        x = [float(v) for v in self.values(unit)]
        return Gait(*x[:4], *x[9:]), Gait(*x[4:8], *x[9:]), x[8]

    def settings(self) -> dict[str, Any]:
        """Returns all settings on which the efficiencies depend."""
        rows = np.stack([self.low, self.high], axis=1).tolist()
        bounds = dict(zip(NAMES, rows, strict=True))
        plan = {"settling": self.plan.settling, "strides": self.plan.strides,
                "steps_per_stride": self.plan.steps_per_stride}  # fmt: skip
        return self.task.settings() | {"bounds": bounds, "climb": plan, "cap": CAP, "link": LINK}


def swim_efficiency(experiment: Experiment, search: SteadySettings):
    """Returns a function from a gait (6,) in SI units to E_swim; NaN without forward swimming."""
    model = models(experiment)

    def one(x: Float[Array, "6"]) -> Float[Array, ""]:
        gait = Gait(*x)
        _, found, ok, _ = steady_stride(model(gait), gait.frequency, search)
        swims = ok & (found.speed > 0.0) & (found.power > 0.0)
        return jnp.where(swims, found.froude_efficiency, jnp.nan)

    return one


def climb_efficiency(experiment: Experiment, plan: ClimbPlan):
    """Returns a function from (7,) SI values (drive, pin phase, tail) to E_climb = m g U/P.

    The function returns NaN if a step fails or the energy balance has an error above `UNACCOUNTED`.
    """
    base = to_model(experiment, 0)

    def one(x: Float[Array, "7"]) -> Float[Array, ""]:
        gait = Gait(*x[:4], *x[5:])
        climber = to_climber(base, gait.frequency, x[4], gait)
        found, ok = climb_from_rest(climber, gait.frequency, plan)
        true = ok & (jnp.abs(found.unaccounted) < UNACCOUNTED)
        return jnp.where(true, found.efficiency, jnp.nan)

    return one


class TaskEfficiencies:
    """Computes efficiencies of designs in the unit box, on all devices.

    Processes with the same `folder` share the designs.
    """

    def __init__(self, modes: TwoTasks, folder: Path | None = None):
        self.modes = modes
        swim = swim_efficiency(modes.task.experiment, modes.task.search)
        climb = climb_efficiency(modes.task.experiment, modes.plan)

        def shared(objective, part: tuple[int, ...]):
            evaluation = Evaluation(lambda x: objective(modes.values(x, part)))
            return shared_by_folder(evaluation, folder, modes.settings() | {"part": part})

        self._swim, self._climb = shared(swim, SWIM + TAIL), shared(climb, CLIMB + TAIL)

    def __call__(self, designs: np.ndarray, swims: bool, climbs: bool) -> np.ndarray:
        """Returns E_swim and E_climb (n, 2) of designs (n, 11); NaN if not requested or failed."""
        found = np.full((len(designs), 2), np.nan)
        if swims:
            found[:, 0] = self._swim(np.ascontiguousarray(designs[:, SWIM + TAIL]))
        if climbs:
            found[:, 1] = self._climb(np.ascontiguousarray(designs[:, CLIMB + TAIL]))
        return found


def eta(beta: float, efficiencies: np.ndarray, only: np.ndarray) -> np.ndarray:
    """Returns eta (n,) of efficiencies (n, 2). An efficiency with weight 0 may be NaN."""
    weights = np.array([beta, 1.0 - beta])
    counts = weights > 0.0
    return (efficiencies[:, counts] / only[counts]) @ weights[counts]
