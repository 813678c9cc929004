"""What the paper leaves open or prints inconsistently, as parameters with ranges."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slider_jax import paper
from slider_jax.actuation import Ideal
from slider_jax.beam.parameters import SLIDER, Robot, Scalar, uniform_robot
from slider_jax.dynamics.model import Drive, Model
from slider_jax.effects import NormalDrag, ReactiveForce
from slider_jax.effects.water.head_added_mass import HeadAddedMass
from slider_jax.effects.water.head_drag import HeadDrag
from slider_jax.effects.water.tangential_friction import TangentialFriction
from slider_jax.statements.switched_lag import SwitchedLag
from slider_jax.supports import Clamped, Free
from slider_jax.swimming.gait import Gait
from slider_jax.swimming.paper_optimum import HEAD_DRAG

ADAPTER_EI = 1.0
"""Bending stiffness [N m^2] of the adapter, 26 times that of the body: practically rigid."""


class Range(NamedTuple):
    """Range of an assumption. A range with `log` is searched in the logarithm of the value."""

    low: float
    high: float
    unit: str
    reason: str
    log: bool = False


class Assumptions(eqx.Module):
    """The assumed values, in SI units; `RANGES` has units and reasons. Defaults: built-in robot."""

    front_start: Scalar = SLIDER["front_chamber"][0]
    front_end: Scalar = SLIDER["front_chamber"][1]
    rear_start: Scalar = SLIDER["rear_chamber"][0]
    rear_end: Scalar = SLIDER["rear_chamber"][1]
    EI_body: Scalar = SLIDER["EI_body"]
    adapter: Scalar = 1e-3
    K_Q: Scalar = SLIDER["K_Q"]
    pressure_start: Scalar = -1.0
    k: Scalar = paper.PRESSURE_LAG
    pressure: Scalar = 365e3
    phase: Scalar = 0.05
    EA: Scalar = SLIDER["EA_body"]
    damping_time: Scalar = SLIDER["damping_time"]
    head_drag: Scalar = HEAD_DRAG
    friction: Scalar = 0.0
    head_added_mass: Scalar = 0.0

    def values(self) -> dict[str, float]:
        """Returns the values by name, in the order of `RANGES`."""
        return {name: float(getattr(self, name)) for name in RANGES}

    def robot(self, tail_length: Scalar, EI_tail: Scalar) -> Robot:
        """Returns the robot with a tail; the body's hindmost piece is the adapter."""
        robot = uniform_robot(
            tail_length=tail_length,
            EI_tail=EI_tail,
            EA_body=self.EA,
            EA_tail=self.EA,
            damping_time=self.damping_time,
            K_Q=self.K_Q,
            front_chamber=(self.front_start, self.front_end),
            rear_chamber=(self.rear_start, self.rear_end),
        )
        length = SLIDER["body_length"]
        stiffness = jnp.stack([jnp.asarray(self.EI_body), jnp.asarray(ADAPTER_EI)])
        body = replace(
            robot.body,
            lengths=jnp.stack([jnp.asarray(length - self.adapter), jnp.asarray(self.adapter)]),
            EI=jnp.stack([stiffness, stiffness], axis=1),
        )
        return replace(robot, body=body)

    def swimmer(self, gait: Gait) -> Model:
        """Returns the free swimmer with a drive and a tail."""
        return self._model(gait, Free())

    def head_fixed(self, frequency: Scalar) -> Model:
        """Returns the robot of the head-fixed sweep, with the tail of the paper's table."""
        gait = Gait(frequency, self.pressure, self.pressure, self.phase,
                    SLIDER["tail_length"], SLIDER["EI_tail"])  # fmt: skip
        return self._model(gait, Clamped())

    def _model(self, gait: Gait, support) -> Model:
        C_d, m_a = paper.force_coefficients(gait.frequency)
        waves = (
            SwitchedLag(gait.frequency, gait.front, self.k, self.pressure_start),
            SwitchedLag(gait.frequency, gait.rear, self.k, self.pressure_start, gait.phase),
        )
        model = Model(
            robot=self.robot(gait.tail_length, gait.EI_tail),
            effects=(
                NormalDrag(C_d),
                ReactiveForce(m_a),
                HeadDrag(self.head_drag),
                TangentialFriction(self.friction),
                HeadAddedMass(self.head_added_mass),
            ),
            pressure_law=Ideal(),
            drive=Drive(waves),
            support=support,
        )
        return jax.tree.map(lambda x: jnp.asarray(x, float), model)


RANGES = {
    "front_start": Range(0.0, 0.08, "m", "not given; distance from the head"),
    "front_end": Range(0.10, 0.20, "m", "not given; distance from the head"),
    "rear_start": Range(
        0.0, 0.20, "m", "not given; 0 is a couple at the end of the chamber, as in the paper's text"
    ),
    "rear_end": Range(0.22, 0.298, "m", "not given; the text says: at the posterior adapter"),
    "EI_body": Range(
        0.0112, 0.038, "N m^2", "38 mN m^2 in the table; 102 mm at 45 kPa need 3.4 times less", True
    ),
    "adapter": Range(1e-3, 0.04, "m", "length of the rigid adapter, not given"),
    "K_Q": Range(
        4.79e-7, 1.63e-6, "m^3", "479 mm^3 in the table; 102 mm at 45 kPa need 3.4 times more", True
    ),
    "pressure_start": Range(
        -1.0, 1.0, "-", "the printed p_0 is dimensionally wrong; see `SwitchedLag`"
    ),
    "k": Range(0.02, 0.15, "s", "87 ms in the table, for a step of the pressure", True),
    "pressure": Range(
        100e3, 450e3, "Pa", "not given for the sweep and Fig. 7; 365 kPa give Q_set", True
    ),
    "phase": Range(-0.1, 0.3, "-", "not given for the head-fixed sweep"),
    "EA": Range(1e3, 1e5, "N", "not given", True),
    "damping_time": Range(5e-6, 1e-2, "s", "5e-6 s in the table, which damps nothing", True),
    "head_drag": Range(
        2e-4, 2e-2, "m^2", "not in the paper's equations, but without it no speed is steady", True
    ),
    "friction": Range(0.0, 0.1, "-", "not in the paper's equations"),
    "head_added_mass": Range(0.0, 1.5, "-", "the paper does not say where the added mass begins"),
}
"""Ranges of the fields of `Assumptions`, set before any search."""


def from_unit(x: Array | np.ndarray) -> Assumptions:
    """Returns the assumptions at a point `x` (16,) of the unit box."""
    values = {}
    for share, (name, one) in zip(x, RANGES.items(), strict=True):
        if one.log:
            values[name] = one.low * (one.high / one.low) ** share
        else:
            values[name] = one.low + share * (one.high - one.low)
    return Assumptions(**values)


def to_unit(assumed: Assumptions) -> np.ndarray:
    """Returns the point of the unit box; values beyond a range are moved to its end."""
    found = []
    for name, one in RANGES.items():
        value = float(getattr(assumed, name))
        low, high = one.low, one.high
        if one.log:
            value, low, high = np.log([value, low, high])
        found.append(np.clip((value - low) / (high - low), 0.0, 1.0))
    return np.array(found)
