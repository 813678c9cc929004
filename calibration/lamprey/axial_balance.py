"""The balance of axial force on a swimmer, stride by stride, and how well one animal fixes it.

Over whole strides

    mean force of the water along the course = change of the body's momentum / time

What the model's forces leave of this is the imbalance; a swimmer at a steady speed has none. Every
force is linear in its coefficient, so that a ledger of forces at unit coefficients serves all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from calibration.lamprey.animal import CrossSections, force, momentum, prescribe
from calibration.lamprey.midlines import Midlines
from calibration.lamprey.motion import Motion, Smoothing, angles, midline_motion, white_noise
from calibration.lamprey.strides import Strides
from slider_jax.effects import ForceDensity, NormalDrag, ReactiveForce
from slider_jax.effects.water.head_drag import HeadDrag
from slider_jax.effects.water.tangential_friction import TangentialFriction
from slider_jax.effects.water.thinned_friction import ThinnedFriction

EFFECTS: dict[str, ForceDensity] = {
    "reactive_force": ReactiveForce(1.0),
    "normal_drag": NormalDrag(1.0),
    "tangential_friction": TangentialFriction(1.0),
    "thinned_friction": ThinnedFriction(1.0),
    "head_drag": HeadDrag(1.0),
}
"""At unit coefficients."""
BASE = ("reactive_force", "normal_drag")
"""Of the robot's model: coefficients m_a and C_d."""
CANDIDATES = ("tangential_friction", "thinned_friction", "head_drag")
"""That the model lacks."""

C_D_RANGE = (1.0, 4.0)
"""A smooth round section in steady flow, and the largest of the paper's."""
M_A_RANGE = (0.7, 1.1)
"""Below 1 where fins shed early, above it for sections that are no plates."""
ASPECT_RANGE = (1.1, 1.9)
"""Depth over width: nearly round, and what a sea lamprey's weight at its length allows at most."""
TAIL_RANGE = (0.025, 0.055)
"""Depth at the tail's end, in lengths."""
LENGTH_ERROR = 0.01
"""Of the length, one standard deviation: half the spread of what was traced."""
COARSER = (0.75, 1.5)
"""Factors on the smoothing's wavelength; on its cutoff the inverses."""
MOTIONS, DRAWS = 24, 400
"""Readings of the midlines, and draws of everything."""


class Ledger(NamedTuple):
    """Mean forces [N] along the course of every stride."""

    unit: dict[str, np.ndarray]
    """By effect, (strides,), at a unit coefficient."""
    gain: np.ndarray
    """(strides,): momentum gained per time."""

    def imbalance(self, C_d: float, m_a: float) -> np.ndarray:
        """(strides,) [N]: what the model gives beyond the momentum gained."""
        return m_a * self.unit[BASE[0]] + C_d * self.unit[BASE[1]] - self.gain


@dataclass(frozen=True)
class Course:
    """Where the forces are taken: the strides, and the axis of the mean course."""

    strides: Strides
    direction: np.ndarray


def ledger(motion: Motion, shape: CrossSections, course: Course) -> Ledger:
    """The forces of a motion, stride by stride."""
    held, t = prescribe(motion, shape), np.asarray(motion.t)

    def along(vector):
        return np.asarray(vector) @ course.direction

    unit = {n: course.strides.means(t, along(force(e, held))) for n, e in EFFECTS.items()}
    return Ledger(unit, course.strides.gains(t, along(momentum(held))))


class Draws(NamedTuple):
    """Alternatives that the data and what is known beforehand allow, one an entry."""

    ledgers: Sequence[Ledger]
    C_d: np.ndarray
    m_a: np.ndarray
    weights: np.ndarray
    """(draws, strides) of the strides, sum 1."""

    def mean(self, series: Sequence[np.ndarray]) -> np.ndarray:
        """(draws,): weighted means over the strides."""
        return np.sum(self.weights * np.array(series), axis=1)

    @property
    def imbalance(self) -> np.ndarray:
        """(draws,) [N]"""
        pairs = zip(self.ledgers, self.C_d, self.m_a, strict=True)
        return self.mean([x.imbalance(C_d, m_a) for x, C_d, m_a in pairs])

    def unit(self, effect: str) -> np.ndarray:
        """(draws,) [N]: an effect's mean force at a unit coefficient."""
        return self.mean([x.unit[effect] for x in self.ledgers])

    def closing(self, effect: str) -> np.ndarray:
        """(draws,): the coefficient at which an effect, others as they are, closes the balance."""
        now = {BASE[0]: self.m_a, BASE[1]: self.C_d}.get(effect, 0.0)
        return now - self.imbalance / self.unit(effect)


def central_interval(values: np.ndarray) -> tuple[float, float]:
    """The middle 95 %."""
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def stride_weights(strides: int, draws: int, rng: np.random.Generator) -> np.ndarray:
    """(draws, strides): a bootstrap over strides, widened to Student's interval of their mean.

    With few strides a plain bootstrap is too narrow: it divides by n and knows no tails.
    """
    picked = rng.multinomial(strides, np.full(strides, 1.0 / strides), size=draws) / strides
    student = stats.t.ppf(0.975, strides - 1) / stats.norm.ppf(0.975)
    wide = student * np.sqrt(strides / (strides - 1.0))
    return 1.0 / strides + wide * (picked - 1.0 / strides)


def alternative_motions(
    midlines: Midlines, smoothing: Smoothing, rng: np.random.Generator, count: int = MOTIONS
) -> list[Motion]:
    """Motions that the same midlines allow: other smoothing, length, and their noise once more."""
    across = float(np.median(midlines.lengths)) / (midlines.points.shape[1] - 1)
    noise = white_noise(angles(midlines).phi) * across / np.sqrt(2.0)
    sigma = np.concatenate([noise[:1], noise])
    found = []
    for _ in range(count):
        coarser, slower = rng.uniform(*COARSER, 2)
        length = np.median(midlines.lengths) * (1.0 + LENGTH_ERROR * rng.standard_normal())
        shaken = midlines.points + sigma[:, None] * rng.standard_normal(midlines.points.shape)
        found.append(
            midline_motion(
                replace(midlines, points=shaken),
                Smoothing(smoothing.wavelength * coarser, smoothing.cutoff / slower),
                float(length),
            )
        )
    return found


def sample_balance(
    rng: np.random.Generator,
    motions: Sequence[Motion],
    shape: CrossSections,
    course: Course,
    coefficients: tuple[float, float],
    vary: Sequence[str],
    count: int = DRAWS,
) -> Draws:
    """Draws in which some of "strides", "reading", "shape", "coefficients" vary.

    `motions[0]` is the motion as it was read; `coefficients` is (C_d, m_a).
    """
    strides = course.strides.number
    same = np.full((count, strides), 1.0 / strides)
    weights = stride_weights(strides, count, rng) if "strides" in vary else same
    C_d, m_a = (np.full(count, x) for x in coefficients)
    if "coefficients" in vary:
        C_d, m_a = rng.uniform(*C_D_RANGE, count), rng.uniform(*M_A_RANGE, count)
    kept: dict[tuple[int, CrossSections], Ledger] = {}
    ledgers = []
    for _ in range(count):
        which = int(rng.integers(1, len(motions))) if "reading" in vary else 0
        here = shape
        if "shape" in vary:
            aspect, tail = rng.uniform(*ASPECT_RANGE), rng.uniform(*TAIL_RANGE)
            here = shape.with_depth(aspect, tail)
        key = (which, here)
        if key not in kept:
            kept[key] = ledger(motions[which], here, course)
        ledgers.append(kept[key])
    return Draws(ledgers, C_d, m_a, weights)
