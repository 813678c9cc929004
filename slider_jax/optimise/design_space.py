"""Defines the designs of a swimmer: bounds of the variables, models, and experiment files."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.dynamics.model import Model
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, coefficients_at, to_model
from slider_jax.experiment.schema import RobotTable, Trial
from slider_jax.io.toml import quantity_of, significant, toml_text
from slider_jax.swimming.gait import Gait, to_swimmer
from slider_jax.swimming.steady_state import SteadySettings, find_steady, steady_speed


class Variable(NamedTuple):
    """A design variable, which is a field of `Gait`."""

    low: float
    high: float
    """Default lower bound `low` and upper bound `high`, in SI units."""
    table: type[Trial] | type[RobotTable]
    field: str
    """Key in the `table` of an experiment file. The key's allowed range limits the bounds."""
    unit: str
    factor: float
    """`unit` is the displayed unit, and `factor` converts a value from the SI unit to this unit."""


VARIABLES = {
    "frequency": Variable(1.0, 7.0, Trial, "frequency", "Hz", 1.0),
    "front": Variable(50e3, 448e3, Trial, "amplitude", "kPa", 1e-3),
    "rear": Variable(50e3, 448e3, Trial, "amplitude", "kPa", 1e-3),
    "phase": Variable(-0.5, 0.5, Trial, "phase", "of a period", 1.0),
    "tail_length": Variable(0.020, 0.100, RobotTable, "tail_length", "mm", 1e3),
    "EI_tail": Variable(0.001, 0.038, RobotTable, "EI_tail", "mN m^2", 1e3),
}
"""Design variables in the order of `Gait`. The bounds are assumed. The highest frequency and the
highest pressure are the paper's values. The stiffest tail is as stiff as the body; the paper's
optimum has the largest stiffness that its optimiser allowed, 17 mN m^2."""


@dataclass(frozen=True)
class GaitBounds:
    """Bounds (6,) of `Gait`, in SI units. The unit box scales each variable to the range 0 to 1."""

    low: np.ndarray
    high: np.ndarray

    def gait(self, unit: Float[Array, "6"] | np.ndarray) -> Gait:
        """Returns the design at a point of the unit box."""
        return Gait(*(self.low + unit * (self.high - self.low)))

    def unit(self, gait: Gait) -> np.ndarray:
        """Returns the point of the unit box for a design."""
        return (np.array(gait) - self.low) / (self.high - self.low)


def gait_bounds(given: Mapping[str, tuple[float, float] | None]) -> GaitBounds:
    """Returns the bounds `given`, and the default bounds of the other variables.

    Raises `InputError` for reversed bounds and for bounds outside the physical range.
    """
    chosen = []
    for name, variable in VARIABLES.items():
        low, high = given.get(name) or (variable.low, variable.high)
        option = f"--{name.replace('_', '-')}"
        if not low < high:
            raise InputError.value(option, f"{low:g} {high:g}", "LOW HIGH with LOW < HIGH")
        allowed = quantity_of(variable.table.model_fields[variable.field])
        assert allowed is not None
        for value in (low, high):
            if not allowed.low <= value <= allowed.high:
                raise InputError.value(option, f"{value:g}", allowed.allowed)
        chosen.append((low, high))
    low, high = np.array(chosen).T
    return GaitBounds(low, high)


def models(experiment: Experiment) -> Callable[[Gait], Model]:
    """Returns a function from a gait to the model of the free swimmer with this gait.

    The function changes the model of the first trial, and is differentiable. The drive is a square
    wave. Coefficients of drag and added mass that depend on the frequency, and the parameter
    `stride_frequency` of effects, follow the gait's frequency.
    """
    base = to_model(experiment, 0)

    def model(gait: Gait) -> Model:
        changes: dict[int, dict[str, Any]] = {}
        if experiment.parameters.force_coefficients != "fixed":
            C_d, m_a = coefficients_at(experiment.parameters, gait.frequency)
            changes = {0: {"C_d": C_d}, 1: {"m_a": m_a}}
        for i, table in enumerate(experiment.effects, start=2):
            names = {field.name for field in fields(base.effects[i])} - set(table.model_extra or {})
            if "stride_frequency" in names:
                changes[i] = {"stride_frequency": gait.frequency}
        effects = tuple(replace(e, **changes.get(i, {})) for i, e in enumerate(base.effects))
        return to_swimmer(replace(base, effects=effects), gait)

    return model


def speed_of(experiment: Experiment, box: GaitBounds, search: SteadySettings):
    """Returns a function from a point of the unit box to the steady speed [m/s], NaN if none."""
    model = models(experiment)

    def speed(unit: Float[Array, "6"]) -> Float[Array, ""]:
        gait = box.gait(unit)
        found = find_steady(model(gait), gait.frequency, search)
        return jnp.where(found.ok, found.speed, jnp.nan)

    return speed


def slope_of(experiment: Experiment, box: GaitBounds, search: SteadySettings):
    """Returns a function from a point of the unit box to (steady speed [m/s], gradient (6,)).

    The gradient is in m/s per width of the bounds.
    """
    model = models(experiment)

    def speed(unit: Float[Array, "6"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        gait = box.gait(unit)
        value = steady_speed(model(gait), gait.frequency, search)
        return value, value

    return lambda unit: jax.jacfwd(speed, has_aux=True)(unit)[::-1]


def with_gait(experiment: Experiment, gait: Gait) -> Experiment:
    """Returns the experiment, reduced to the first trial, with the drive and tail of a gait.

    The trial has no biases, and no own ratios and phases of the chambers. The time step is
    shortened if the gait's frequency requires it.
    """
    f, front, rear, phase, tail_length, EI_tail = (significant(float(x), 10) for x in gait)
    first = {"waveform": "square", "frequency": f, "amplitude": front, "phase": phase,
             "rear_ratio": rear / front, "ratios": None, "phases": None, "biases": None,
             "initial": None}  # fmt: skip
    step = min(experiment.numerics.step, significant(0.0499 / f, 6))
    values = {"robot.tail_length": tail_length, "robot.EI_tail": EI_tail, "numerics.step": step,
              "trials": [experiment.trials[0].model_dump() | first]}  # fmt: skip
    return experiment.with_values(values, "design")


def to_toml(experiment: Experiment, comment: str = "") -> str:
    """Returns an experiment as the text of its file; default values are omitted."""
    return toml_text(experiment.model_dump(exclude_defaults=True, exclude_none=True), comment)
