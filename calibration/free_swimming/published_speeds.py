"""Compares published free-swimming speeds with the paper's equations and with added resistance.

The paper's drag acts only normal to the body, so nothing resists axial motion. In the model, the
robot accelerates far beyond the measured speed, until its stroke no longer gives thrust. So this
module adds an effect that resists axial motion. The effect is calibrated on one published speed,
and predicts the other published speed. The quantities that the paper does not give are varied. The
spread of the predictions shows their uncertainty. Both speeds were measured: 21.3 cm/s with a tail
of 60 mm (Fig. 7d), and 21.7 cm/s with the optimal gait and a tail of 70 mm.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import root_scalar

from slider_jax import paper
from slider_jax.actuation import FirstOrderLag
from slider_jax.beam.parameters import uniform_robot
from slider_jax.dynamics.model import Drive, Model
from slider_jax.dynamics.rollout import rollout
from slider_jax.dynamics.step import at_rest
from slider_jax.effects import Effect, NormalDrag, ReactiveForce
from slider_jax.effects.water.head_added_mass import HeadAddedMass
from slider_jax.effects.water.head_drag import HeadDrag
from slider_jax.effects.water.tangential_friction import TangentialFriction
from slider_jax.errors import SolverError
from slider_jax.supports import Free
from slider_jax.swimming.gait import Gait, gait_waves
from slider_jax.swimming.paper_optimum import MEASURED_GAIT, MEASURED_SPEED, PUBLISHED
from slider_jax.swimming.steady_state import (
    Steady,
    SteadySettings,
    find_steady,
    stride_times,
    velocity,
)

STEADY_SETTINGS = SteadySettings(precision=1e-5, corrections=14, steps_per_stride=160)
CORRECTIONS_FACTOR = 3
"""Factor on the number of corrections in the search for the steady speed of a model without axial
resistance. This speed is ten times as high as with resistance."""
STRIDES_FROM_REST = 60
"""Number of simulated strides from rest, sufficient to show whether the speed settles."""


class PublishedPoint(NamedTuple):
    """A published speed. `gaits` are alternative assumptions about the unpublished quantities."""

    name: str
    speed: float
    """Published speed [m/s]."""
    error: float
    """Error of the speed [m/s] that the paper states."""
    gaits: dict[str, Gait]


FIRST = PublishedPoint(
    "5 Hz, phase 0.2",
    0.213,
    0.001,
    {
        "365 kPa (from Q_set), EI of the paper's table": Gait(
            5.0, 365e3, 365e3, 0.2, 0.060, 0.0058
        ),
        "260 kPa (as in slider demo), EI of the paper's table": Gait(
            5.0, 260e3, 260e3, 0.2, 0.060, 0.0058
        ),
        "pressures and EI of the optimum": Gait(5.0, 448e3, 414e3, 0.2, 0.060, 0.017),
    },
)
"""The largest measured speed of Fig. 7d. The tail's length is stated. The frequency and the phase
are stated for other panels of Fig. 7 and in the discussion. The paper does not give the pressures,
and gives EI only for the simulation."""
OPTIMUM = PublishedPoint(
    "optimum: 6.3 Hz, phase 0.14", MEASURED_SPEED, 0.004, {"as the paper gives it": MEASURED_GAIT}
)
PAPER_MODEL_AT_OPTIMUM = PUBLISHED["speed_m_per_s"].model
"""Speed [m/s] of the paper's own model, with a tail of 53 mm."""

RESISTIVE_EFFECTS: dict[str, Callable[[Any], Effect]] = {
    "tangential_friction": TangentialFriction,
    "head_drag": HeadDrag,
}
INITIAL_COEFFICIENTS = {"tangential_friction": 0.1, "head_drag": 2e-3}
"""Initial values of the secant search for a coefficient."""
HEAD_ADDED_MASSES = {"without head_added_mass": 0.0, "with head_added_mass": 1.0}
"""Values of m_a in `HeadAddedMass`, a point force at the head that the paper's equations omit."""


def paper_swimmer(
    gait: Gait, resisting: str | None = None, coefficient: float = 0.0, head: float = 0.0
) -> Model:
    """Returns a model of the paper's robot in free swimming, with at most one axial resistance.

    All such models have the same structure, so they share one compiled program.
    """
    C_d, m_a = paper.force_coefficients(gait.frequency)
    coefficients = {name: coefficient if name == resisting else 0.0 for name in RESISTIVE_EFFECTS}
    robot = uniform_robot(tail_length=gait.tail_length, EI_tail=gait.EI_tail)
    model = Model(
        robot=robot,
        effects=(
            NormalDrag(C_d),
            ReactiveForce(m_a),
            HeadAddedMass(head),
            *(effect(coefficients[name]) for name, effect in RESISTIVE_EFFECTS.items()),
        ),
        pressure_law=FirstOrderLag(paper.PRESSURE_LAG),
        drive=Drive(gait_waves(gait, len(robot.chambers))),
        support=Free(),
    )
    return jax.tree.map(lambda x: jnp.asarray(x, float), model)


@eqx.filter_jit
def _from_rest(model: Model, frequency, strides: int, plan: SteadySettings):
    times = stride_times(frequency, strides, plan)
    begin = at_rest(model, plan.numerics)
    run = rollout(model, times, velocity, plan.numerics, plan.scheme, begin=begin, checkpoint=False)
    return run.saved.reshape(strides, plan.steps_per_stride, 2).mean(axis=1), run.ok


_find_steady = eqx.filter_jit(find_steady)


def steady_swim(model: Model, gait: Gait, plan: SteadySettings = STEADY_SETTINGS) -> Steady:
    """Returns the steady swim of a model from `paper_swimmer`."""
    return _find_steady(model, jnp.asarray(float(gait.frequency)), plan)


def coefficient_at(
    point: PublishedPoint,
    gait: Gait,
    resisting: str,
    head: float = 0.0,
    plan: SteadySettings = STEADY_SETTINGS,
) -> float:
    """Returns the coefficient with which the robot swims steadily at a point's speed.

    Raises `SolverError` if the search finds no such coefficient.
    """

    def coefficient(x: float) -> float:
        return INITIAL_COEFFICIENTS[resisting] * float(np.exp(x))

    def relative_error(x: float) -> float:
        swim = steady_swim(paper_swimmer(gait, resisting, coefficient(x), head), gait, plan)
        return float(swim.speed) / point.speed - 1.0 if bool(swim.ok) else np.nan

    root = root_scalar(relative_error, method="secant", x0=0.0, x1=0.3, xtol=1e-4, maxiter=20)
    if not root.converged or not abs(relative_error(root.root)) < 1e-3:
        raise SolverError(
            f"{resisting} at {point.name}: no coefficient gives {point.speed:g} m/s ({root.flag})"
        )
    return coefficient(root.root)


@dataclass(frozen=True)
class UnresistedSwim:
    """Free swimming according to the paper's equations, without axial resistance."""

    point: str
    gait: str
    head: str
    by_stride: np.ndarray
    """Mean speed [m/s] of each stride from rest."""
    steady: float
    """Steady speed [m/s], or infinity if the search found no steady speed."""


@dataclass(frozen=True)
class SpeedPrediction:
    """The speed that an effect, calibrated on one published point, predicts at another point."""

    resisting: str
    head: str
    calibrated_on: str
    gait: str
    coefficient: float
    predicts: str
    predicted_gait: str
    predicted: float
    """Predicted speed [m/s]."""
    published: float

    @property
    def in_prior(self) -> bool:
        """Returns whether the coefficient is within the effect's prior range."""
        (prior,) = RESISTIVE_EFFECTS[self.resisting](0.0).priors().values()
        return prior.low <= self.coefficient <= prior.high

    @property
    def error(self) -> float:
        """Returns the predicted minus the published speed [m/s]."""
        return self.predicted - self.published


def unresisted_swims(
    plan: SteadySettings = STEADY_SETTINGS, strides: int = STRIDES_FROM_REST
) -> list[UnresistedSwim]:
    """Returns the swims at every point and gait, without and with the head's added mass."""
    swims = []
    for point, head in itertools.product((FIRST, OPTIMUM), HEAD_ADDED_MASSES):
        for name, gait in point.gaits.items():
            model, f = (
                paper_swimmer(gait, head=HEAD_ADDED_MASSES[head]),
                jnp.asarray(gait.frequency),
            )
            by_stride, ok = _from_rest(model, f, strides, plan)
            if not bool(ok):
                raise SolverError(f"{point.name}, {name}: a time step from rest did not converge")
            speeds = np.hypot(*np.asarray(by_stride).T)
            long_plan = plan._replace(corrections=CORRECTIONS_FACTOR * plan.corrections)
            steady = _steady_speed(steady_swim(model, gait, long_plan))
            swims.append(UnresistedSwim(point.name, name, head, speeds, steady))
    return swims


def _steady_speed(swim: Steady) -> float:
    """Returns the steady speed [m/s], or infinity if the search found no steady speed."""
    if not bool(swim.carry.ok):
        raise SolverError("a time step of the search for a steady speed did not converge")
    return float(swim.speed) if bool(swim.ok) else float("inf")


def predicted_speeds(
    calibrated: PublishedPoint,
    checked: PublishedPoint,
    plan: SteadySettings = STEADY_SETTINGS,
    heads: Sequence[str] = tuple(HEAD_ADDED_MASSES),
    done: Callable[[SpeedPrediction], None] = lambda x: None,
) -> list[SpeedPrediction]:
    """Returns the speeds that each effect, calibrated on one point, predicts at another point.

    `done` receives each prediction when it is ready.
    """
    predictions = []
    pairs = itertools.product(RESISTIVE_EFFECTS, heads, calibrated.gaits, checked.gaits)
    coefficients: dict[tuple[str, str, str], float] = {}
    for resisting, head, name, other in pairs:
        key = (resisting, head, name)
        if key not in coefficients:
            coefficients[key] = coefficient_at(
                calibrated, calibrated.gaits[name], resisting, HEAD_ADDED_MASSES[head], plan
            )
        gait = checked.gaits[other]
        model = paper_swimmer(gait, resisting, coefficients[key], HEAD_ADDED_MASSES[head])
        speed = _steady_speed(steady_swim(model, gait, plan))
        predictions.append(
            SpeedPrediction(resisting, head, calibrated.name, name, coefficients[key],
                            checked.name, other, speed, checked.speed)
        )  # fmt: skip
        done(predictions[-1])
    return predictions
