"""Values that the paper publishes, and assumed values of quantities that the paper omits.

Source of every published value: Van Stratum et al., Model-based Optimization of Anguilliform
Swimming Gaits for Soft Robotic Applications. The class `Assumed` contains the assumed values.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.actuation import FirstOrderLag, SquareWave
from slider_jax.beam.parameters import Robot, Scalar, uniform_robot
from slider_jax.dynamics.model import Drive, Model
from slider_jax.effects import NormalDrag, ReactiveForce
from slider_jax.supports import Clamped

RAMP_START, RAMP_END = 2.0, 3.0
"""Stride frequencies [Hz] between which the force coefficients change linearly."""
DRAG_DOMINATED = (4.0, 0.0)
"""Coefficients of drag and added mass (C_d, m_a) at frequencies below `RAMP_START`."""
REACTIVE = (3.0, 1.0)
"""Coefficients of drag and added mass (C_d, m_a) at frequencies above `RAMP_END`."""

PRESSURE_LAG = 0.087
"""Time constant k [s] of the pressure."""
TRANSIENT_STRIDES = 3
"""Number of strides before the motion is steady; in the paper, "after 3 tailbeat cycles"."""
SWEEP = tuple(round(0.4 + 0.2 * i, 1) for i in range(34))
"""Frequencies [Hz] of the head-fixed sweep: 0.4 to 7.0 Hz in steps of 0.2 Hz."""

MINIMUM_NEAR = 1.0
"""Frequency [Hz] near which the mean thrust has its minimum, which is negative."""
PEAK_AT, PEAK_THRUST = 4.8, 0.060
"""Frequency [Hz] and size [N] of the largest mean thrust; the paper says "near 60 mN"."""
ROLL_OFF = 0.020
"""Decrease of the mean thrust per frequency [N/Hz] beyond the largest mean thrust."""
RECOIL_THERE = 1.0
"""Recoil [N] that the measured recoil exceeds for the fractions `RECOIL_SHARES` of a stride."""
RECOIL_SHARES = {1.0: 0.6, 4.8: 0.4}
"""Fraction of a stride with a recoil above `RECOIL_THERE`, by frequency [Hz]."""

NEAR, ABOUT, NEAR_HZ, NEAR_SHARE = 0.10, 0.25, 0.2, 0.1
"""Tolerances for agreement with the paper: relative, for results; relative, for results that the
paper calls approximate; of a frequency [Hz], one step of the sweep; of a fraction of a stride."""


def force_coefficients(frequency: Scalar) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Returns (C_d, m_a) at a stride `frequency` [Hz]; both change linearly from 2 to 3 Hz."""
    share = jnp.clip((frequency - RAMP_START) / (RAMP_END - RAMP_START), 0.0, 1.0)
    C_d, m_a = (
        low + share * (high - low) for low, high in zip(DRAG_DOMINATED, REACTIVE, strict=True)
    )
    return C_d, m_a


class Assumed(eqx.Module):
    """Values of quantities that the paper omits. `Robot` has the assumed ends of the chambers.

    | field | unit | meaning |
    |---|---|---|
    | `amplitude` | Pa | amplitude of the front chamber's square wave of set pressure |
    | `rear_ratio` | - | ratio of the rear to the front amplitude |
    | `phase` | - | delay of the rear chamber's set pressure, as a fraction of a stride |

    With these values, the mean thrust is 58 mN at 4.8 Hz, where the paper has its largest thrust of
    about 60 mN. But the largest thrust is 82 mN at 4.0 Hz. The minimum is at 1.0 Hz for all phases
    from 0 to 0.05, as in the paper, and at 1.4 Hz for a phase of 0.15. With a phase of 0.3, the
    mean thrust has no minimum.
    """

    amplitude: Scalar = 260e3
    rear_ratio: Scalar = 1.0
    phase: Scalar = 0.05


def head_fixed(
    frequency: Scalar, robot: Robot | None = None, assumed: Assumed | None = None
) -> Model:
    """Returns a model of the paper's head-fixed experiment in still water at a `frequency` [Hz]."""
    robot = uniform_robot() if robot is None else robot
    assumed = Assumed() if assumed is None else assumed
    C_d, m_a = force_coefficients(frequency)
    front = SquareWave(frequency, assumed.amplitude)
    rear = SquareWave(frequency, assumed.amplitude * assumed.rear_ratio, assumed.phase)
    return Model(
        robot=robot,
        effects=(NormalDrag(C_d), ReactiveForce(m_a)),
        pressure_law=FirstOrderLag(PRESSURE_LAG),
        drive=Drive((front, rear)),
        support=Clamped(),
    )
