"""The paper's free-swimming speeds as data: what its own equations lack to swim at them.

With drag across the body only, nothing resists motion along it, and the robot gains speed until
the stroke itself gives out, far beyond what was measured. An effect that resists is
calibrated on one published point and predicts the other; what the paper does not say of a point is
varied, so that the prediction has an interval.
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
from slider_jax.actuation import FirstOrderLag, SquareWave
from slider_jax.beam.parameters import Robot
from slider_jax.dynamics.model import Drive, Model
from slider_jax.dynamics.rollout import rollout
from slider_jax.dynamics.step import at_rest
from slider_jax.effects import Effect, NormalDrag, ReactiveForce
from slider_jax.effects.water.head_added_mass import HeadAddedMass
from slider_jax.effects.water.head_drag import HeadDrag
from slider_jax.effects.water.tangential_friction import TangentialFriction
from slider_jax.errors import SolverError
from slider_jax.supports import Free
from slider_jax.swimming.gait import Gait
from slider_jax.swimming.paper_optimum import MEASURED_SPEED, PAPER_GAIT, PUBLISHED
from slider_jax.swimming.steady_state import (
    Steady,
    SteadySettings,
    find_steady,
    stride_times,
    velocity,
)

PLAN = SteadySettings(steps_per_stride=160)
FARTHER = 3
"""Times as many corrections of the speed for a swimmer that nothing resists: it ends ten times as
fast."""
LONG = 60
"""Strides from rest that show whether a speed settles."""


class PublishedPoint(NamedTuple):
    """A published speed. `gaits` are the ways to fill in what the paper leaves open."""

    name: str
    speed: float
    """[m/s]"""
    error: float
    """[m/s]; of the first point assumed, as the paper gives none."""
    gaits: dict[str, Gait]


FIRST = PublishedPoint(
    "5 Hz, phase 0.2",
    0.213,
    0.004,
    {
        "365 kPa (Q_set), table's tail": Gait(5.0, 365e3, 365e3, 0.2, 0.070, 0.0058),
        "260 kPa (as fits the head-fixed thrust), table's tail": Gait(
            5.0, 260e3, 260e3, 0.2, 0.070, 0.0058
        ),
        "pressures and tail of the optimum": Gait(5.0, 448e3, 414e3, 0.2, 0.053, 0.017),
    },
)
"""Pressures and tail are not given; all of `gaits` are assumed."""
OPTIMUM = PublishedPoint(
    "optimum: 6.3 Hz, phase 0.14",
    MEASURED_SPEED,
    0.004,
    {"as the paper gives it": PAPER_GAIT},
)
PAPER_MODEL_AT_OPTIMUM = PUBLISHED["speed_m_per_s"].model
"""[m/s], of the paper's own model."""

RESISTING: dict[str, Callable[[Any], Effect]] = {
    "tangential_friction": TangentialFriction,
    "head_drag": HeadDrag,
}
START = {"tangential_friction": 0.1, "head_drag": 2e-3}
"""From where coefficients are sought."""
HEADS = {"no point force at the head": 0.0, "added mass begins at the head": 1.0}
"""m_a of `HeadAddedMass`; the paper's local form has none."""


def paper_swimmer(
    gait: Gait, resisting: str | None = None, coefficient: float = 0.0, head: float = 0.0
) -> Model:
    """The paper's robot set free, with one effect that resists. One program serves all."""
    C_d, m_a = paper.force_coefficients(gait.frequency)
    given = {name: coefficient if name == resisting else 0.0 for name in RESISTING}
    model = Model(
        robot=Robot(tail_length=gait.tail_length, EI_tail=gait.EI_tail),
        effects=(
            NormalDrag(C_d),
            ReactiveForce(m_a),
            HeadAddedMass(head),
            *(kind(given[name]) for name, kind in RESISTING.items()),
        ),
        pressure_law=FirstOrderLag(paper.PRESSURE_LAG),
        drive=Drive(
            SquareWave(gait.frequency, gait.front),
            SquareWave(gait.frequency, gait.rear, gait.phase),
        ),
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


def steady_swim(model: Model, gait: Gait, plan: SteadySettings = PLAN) -> Steady:
    """The steady swim, by one program for all models of one structure."""
    return _find_steady(model, jnp.asarray(float(gait.frequency)), plan)


def coefficient_at(
    point: PublishedPoint,
    gait: Gait,
    resisting: str,
    head: float = 0.0,
    plan: SteadySettings = PLAN,
) -> float:
    """The coefficient with which the robot swims steadily at a point's speed.

    Raises `SolverError` where there is none.
    """

    def coefficient(x: float) -> float:
        return START[resisting] * float(np.exp(x))

    def off(x: float) -> float:
        found = steady_swim(paper_swimmer(gait, resisting, coefficient(x), head), gait, plan)
        return float(found.speed) / point.speed - 1.0 if bool(found.ok) else np.nan

    found = root_scalar(off, method="secant", x0=0.0, x1=0.3, xtol=1e-4, maxiter=20)
    if not found.converged or not abs(off(found.root)) < 1e-3:
        raise SolverError(
            f"{resisting} at {point.name}: no coefficient gives {point.speed:g} m/s ({found.flag})"
        )
    return coefficient(found.root)


@dataclass(frozen=True)
class Before:
    """The paper's equations, set free."""

    point: str
    gait: str
    head: str
    by_stride: np.ndarray
    """Speeds [m/s] of `LONG` strides from rest."""
    steady: float
    """[m/s]; infinite where none was found."""


@dataclass(frozen=True)
class After:
    """One effect calibrated on one point and predicting the other."""

    resisting: str
    head: str
    calibrated_on: str
    gait: str
    coefficient: float
    predicts: str
    predicted_gait: str
    predicted: float
    """[m/s]"""
    published: float

    @property
    def believed(self) -> bool:
        """Whether the coefficient is within the effect's prior range."""
        (prior,) = RESISTING[self.resisting](0.0).priors().values()
        return prior.low <= self.coefficient <= prior.high

    @property
    def error(self) -> float:
        """[m/s], predicted less published."""
        return self.predicted - self.published


def before(plan: SteadySettings = PLAN, strides: int = LONG) -> list[Before]:
    """The paper's equations at every point and gait, without and with the head's point force."""
    found = []
    for point, head in itertools.product((FIRST, OPTIMUM), HEADS):
        for name, gait in point.gaits.items():
            model, f = paper_swimmer(gait, head=HEADS[head]), jnp.asarray(gait.frequency)
            by_stride, ok = _from_rest(model, f, strides, plan)
            if not bool(ok):
                raise SolverError(f"{point.name}, {name}: a step failed on the way from rest")
            speeds = np.hypot(*np.asarray(by_stride).T)
            farther = plan._replace(corrections=FARTHER * plan.corrections)
            found.append(
                Before(point.name, name, head, speeds, _speed(steady_swim(model, gait, farther)))
            )
    return found


def _speed(found: Steady) -> float:
    """[m/s]; infinite where no speed is steady."""
    if not bool(found.carry.ok):
        raise SolverError("a step failed on the way to a steady speed")
    return float(found.speed) if bool(found.ok) else float("inf")


def after(
    calibrated: PublishedPoint,
    checked: PublishedPoint,
    plan: SteadySettings = PLAN,
    heads: Sequence[str] = tuple(HEADS),
    done: Callable[[After], None] = lambda x: None,
) -> list[After]:
    """Every effect calibrated on one point, and what it predicts of another."""
    found = []
    pairs = itertools.product(RESISTING, heads, calibrated.gaits, checked.gaits)
    coefficients: dict[tuple[str, str, str], float] = {}
    for resisting, head, name, other in pairs:
        key = (resisting, head, name)
        if key not in coefficients:
            coefficients[key] = coefficient_at(
                calibrated, calibrated.gaits[name], resisting, HEADS[head], plan
            )
        gait = checked.gaits[other]
        model = paper_swimmer(gait, resisting, coefficients[key], HEADS[head])
        speed = _speed(steady_swim(model, gait, plan))
        found.append(
            After(resisting, head, calibrated.name, name, coefficients[key], checked.name, other,
                  speed, checked.speed)
        )  # fmt: skip
        done(found[-1])
    return found
