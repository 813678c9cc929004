"""The axial force balance of a swimmer in every stride, and the uncertainty of this balance.

For whole strides, the balance is

    mean force of the water along the course = change of the body's momentum / duration

The imbalance is the modelled mean force minus the momentum gained per time. A complete model has an
imbalance of zero. The force of an effect is proportional to the effect's coefficient.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from calibration.lamprey.animal import CrossSections, force_on_body, momentum, prescribe
from calibration.lamprey.midlines import Midlines
from calibration.lamprey.motion import (
    Motion,
    Smoothing,
    measured_angles,
    midline_motion,
    white_noise,
)
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
"""All effects of the balance, with coefficients of 1."""
BASE_EFFECTS = ("reactive_force", "normal_drag")
"""Effects that the robot's model includes, with the coefficients m_a and C_d."""
CANDIDATES = ("tangential_friction", "thinned_friction", "head_drag")
"""Effects that the robot's model omits."""

C_D_RANGE = (1.0, 4.0)
"""Range of C_d, from 1 (smooth round section in steady flow) to 4 (the paper's largest value)."""
M_A_RANGE = (0.7, 1.1)
"""Range of m_a: below 1 if the fins shed vortices ahead of the tail, above 1 for thick sections."""
ASPECT_RANGE = (1.1, 1.9)
"""Range of depth divided by width: nearly round at 1.1; above 1.9, the mass would be too large."""
TAIL_RANGE = (0.025, 0.055)
"""Range of the depth at the tail's end, in body lengths."""
LENGTH_ERROR = 0.01
"""Relative standard deviation of the body length: half the spread of the traced lengths."""
SMOOTHING_FACTORS = (0.75, 1.5)
"""Range of random factors of the smoothing's wavelength and of 1/(cutoff frequency)."""
MOTIONS, SAMPLES = 24, 400
"""Number of alternative motions, and number of random samples for an interval."""


class StrideForces(NamedTuple):
    """Mean forces [N] along the course in every stride."""

    unit: dict[str, np.ndarray]
    """Force (strides,) of each effect with a coefficient of 1."""
    gain: np.ndarray
    """Change of the body's momentum per time, (strides,) [N]."""

    def imbalance(self, C_d: float, m_a: float) -> np.ndarray:
        """Returns the imbalance (strides,) [N]: modelled force minus momentum gained per time."""
        return m_a * self.unit[BASE_EFFECTS[0]] + C_d * self.unit[BASE_EFFECTS[1]] - self.gain


@dataclass(frozen=True)
class Course:
    """The strides in which forces are averaged, and the direction of the mean course."""

    strides: Strides
    direction: np.ndarray
    """Unit vector (2,) of the mean course."""


def forces_by_stride(motion: Motion, shape: CrossSections, course: Course) -> StrideForces:
    """Returns the mean forces of a motion in every stride."""
    prescribed, t = prescribe(motion, shape), np.asarray(motion.t)

    def along(vector):
        return np.asarray(vector) @ course.direction

    forces = {name: along(force_on_body(effect, prescribed)) for name, effect in EFFECTS.items()}
    unit = {name: course.strides.means(t, force) for name, force in forces.items()}
    return StrideForces(unit, course.strides.gains(t, along(momentum(prescribed))))


class BalanceSamples(NamedTuple):
    """Random samples of forces, coefficients and weights of the strides."""

    stride_forces: Sequence[StrideForces]
    C_d: np.ndarray
    m_a: np.ndarray
    weights: np.ndarray
    """Weight of each stride, (samples, strides). The sum of each row is 1."""

    def mean(self, series: Sequence[np.ndarray]) -> np.ndarray:
        """Returns the weighted mean (samples,) of `series` (samples, strides) over the strides."""
        return np.sum(self.weights * np.array(series), axis=1)

    @property
    def imbalance(self) -> np.ndarray:
        """Mean imbalance of each sample, (samples,) [N]."""
        pairs = zip(self.stride_forces, self.C_d, self.m_a, strict=True)
        return self.mean([x.imbalance(C_d, m_a) for x, C_d, m_a in pairs])

    def unit(self, effect: str) -> np.ndarray:
        """Returns the mean force (samples,) [N] of an effect with a coefficient of 1."""
        return self.mean([x.unit[effect] for x in self.stride_forces])

    def closing(self, effect: str) -> np.ndarray:
        """Returns the coefficient (samples,) of `effect` that alone makes the imbalance zero."""
        current = {BASE_EFFECTS[0]: self.m_a, BASE_EFFECTS[1]: self.C_d}.get(effect, 0.0)
        return current - self.imbalance / self.unit(effect)


def central_interval(values: np.ndarray) -> tuple[float, float]:
    """Returns the 2.5 % and 97.5 % quantiles of `values`."""
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def stride_weights(strides: int, samples: int, rng: np.random.Generator) -> np.ndarray:
    """Returns bootstrap weights of the strides, (samples, strides).

    With few strides, a plain bootstrap interval is too narrow: its variance is too small, and its
    quantiles are normal instead of Student's. The weights are scaled to give Student's interval.
    """
    picked = rng.multinomial(strides, np.full(strides, 1.0 / strides), size=samples) / strides
    student = stats.t.ppf(0.975, strides - 1) / stats.norm.ppf(0.975)
    scale = student * np.sqrt(strides / (strides - 1.0))
    return 1.0 / strides + scale * (picked - 1.0 / strides)


def alternative_motions(
    midlines: Midlines, smoothing: Smoothing, rng: np.random.Generator, count: int = MOTIONS
) -> list[Motion]:
    """Returns `count` motions with random smoothing, body length and tracing noise."""
    across = float(np.median(midlines.lengths)) / (midlines.points.shape[1] - 1)
    noise = white_noise(measured_angles(midlines).phi) * across / np.sqrt(2.0)
    sigma = np.concatenate([noise[:1], noise])
    motions = []
    for _ in range(count):
        longer, lower = rng.uniform(*SMOOTHING_FACTORS, 2)
        length = np.median(midlines.lengths) * (1.0 + LENGTH_ERROR * rng.standard_normal())
        noisy = midlines.points + sigma[:, None] * rng.standard_normal(midlines.points.shape)
        motions.append(
            midline_motion(
                replace(midlines, points=noisy),
                Smoothing(smoothing.wavelength * longer, smoothing.cutoff / lower),
                float(length),
            )
        )
    return motions


def sample_balances(
    rng: np.random.Generator,
    motions: Sequence[Motion],
    shape: CrossSections,
    course: Course,
    coefficients: tuple[float, float],
    vary: Sequence[str],
    count: int = SAMPLES,
) -> BalanceSamples:
    """Returns samples in which only the sources of uncertainty in `vary` are random.

    The sources are "strides" (weights), "reading" (motions), "shape" and "coefficients" (C_d, m_a).
    `motions[0]` is the motion of the measured midlines. All other motions are alternatives.
    """
    strides = course.strides.number
    equal = np.full((count, strides), 1.0 / strides)
    weights = stride_weights(strides, count, rng) if "strides" in vary else equal
    C_d, m_a = (np.full(count, x) for x in coefficients)
    if "coefficients" in vary:
        C_d, m_a = rng.uniform(*C_D_RANGE, count), rng.uniform(*M_A_RANGE, count)
    cached: dict[tuple[int, CrossSections], StrideForces] = {}
    stride_forces = []
    for _ in range(count):
        index = int(rng.integers(1, len(motions))) if "reading" in vary else 0
        sampled_shape = shape
        if "shape" in vary:
            aspect, tail = rng.uniform(*ASPECT_RANGE), rng.uniform(*TAIL_RANGE)
            sampled_shape = shape.with_depth(aspect, tail)
        key = (index, sampled_shape)
        if key not in cached:
            cached[key] = forces_by_stride(motions[index], sampled_shape, course)
        stride_forces.append(cached[key])
    return BalanceSamples(stride_forces, C_d, m_a, weights)
