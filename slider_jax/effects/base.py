"""What an effect is: one physical cause, its parameters as leaves, and the one method that adds it.

A model is a list of effects; the solver never knows which. Every effect enters at one of the places
below, each a class with one abstract method. An effect's parameters are declared with `parameter`:
its null value, at which the effect vanishes, and the range that one would believe before looking at
data, with the reason.
"""

import re
from abc import abstractmethod
from dataclasses import fields
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.actuation.waveform import Waveform
from slider_jax.beam.equations import Section
from slider_jax.beam.parameters import Robot


class Prior(NamedTuple):
    """What is believed of a parameter before data: `low` to `high`, vanishing at `null`.

    `start` is where an effect has to be tried whose tangent at its null does not tell what it does
    at its size: a threshold, a limit, another law.
    """

    null: float
    low: float
    high: float
    unit: str
    why: str
    start: float | None = None


def parameter(
    null: float, low: float, high: float, unit: str, why: str, start: float | None = None
) -> Any:
    """Declare an effect's parameter, as `Prior`; made without a value it is at its null."""
    return eqx.field(default=null, metadata={"prior": Prior(null, low, high, unit, why, start)})


class Effect(eqx.Module):
    """One physical cause. Its docstring gives the equation and the source."""

    title: ClassVar[str] = ""
    """What it is, in the words of a report."""
    sensors: ClassVar[tuple[str, ...]] = ("thrust", "recoil", "tip")
    """Channels that can see it, of pressure, thrust, recoil, tip."""
    resists: ClassVar[bool] = False
    """Whether it is a force density that resists motion along the body, which drag across it and
    added mass do not."""
    instead: ClassVar[str] = ""
    """What of the model it takes the place of, if it does; one effect at most can."""

    @classmethod
    def name(cls) -> str:
        """The class's name in lower case with underscores, as files and reports write it."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    @classmethod
    def place(cls) -> str:
        """Where it enters: the name of its place among the classes below."""
        return next(kind.__name__ for kind in cls.__mro__[1:] if kind.__module__ == __name__)

    @classmethod
    def priors(cls) -> dict[str, Prior]:
        """The parameters that may be identified, by name."""
        return {f.name: f.metadata["prior"] for f in fields(cls) if "prior" in f.metadata}


class ForceDensity(Effect):
    """A force per length on the body."""

    in_air: ClassVar[bool] = False
    """Whether it is there without water."""

    @abstractmethod
    def force(self, x: Section) -> tuple[Array, Array]:
        """(F_tau, F_n) [N/m] on a section of the body."""


class BendingMoment(Effect):
    """A moment inside the body beside the elastic and viscous one, with a memory of its own."""

    @abstractmethod
    def moment(self, x: Section, memory: Array, dt: Array) -> tuple[Array, Array]:
        """Moment [N m] in the cells, counted as EI kappa is, and the memory at the stage's end.

        `memory` (cells,) is what (value - memory)/dt subtracts; the new value must follow from the
        section in closed form. An effect without memory hands it back.
        """


MOUNT_LAG = 1e-3
"""[s] of a mounting, a spring with a dashpot beside it: x + MOUNT_LAG dx/dt = -c load.

A loss factor of 0.03 at 5 Hz, as of bolted joints. It also bounds the tangent at c = 0,
where a bare spring would follow every wave front of the body."""


class HeadRates(NamedTuple):
    """Rates of the head's load as a mounting follows it, lagging by `MOUNT_LAG`."""

    T_t: Array
    """dT/dt [N/s]"""
    N_t: Array
    """dN/dt [N/s]"""
    M_t: Array
    """dM/dt [N m/s]"""


class Mounting(Effect):
    """What gives way between carriage and head."""

    @abstractmethod
    def give(self, rates: HeadRates) -> tuple[Array, Array, Array]:
        """Velocity (tau, n) [m/s] and turning rate [rad/s] of the head relative to the carriage."""


class BodyChange(Effect):
    """The body is not as it was measured."""

    @abstractmethod
    def change(self, robot: Robot) -> Robot:
        """The robot as it is, from the robot as it was measured."""


class Command(Effect):
    """What becomes of a set pressure before the valves act on it."""

    @abstractmethod
    def command(self, wave: Waveform, chamber: int) -> Waveform:
        """The waveform that the valves follow; `chamber` is 0 for the front, 1 for the rear."""


class Chamber(NamedTuple):
    """The chambers and their valves at one instant: front and rear, each entry (2,)."""

    p: Array
    """[Pa]"""
    p_set: Array
    """[Pa]"""
    k: Array
    """Time constant [s] of the lag; a number."""
    rear: np.ndarray
    """1 for the rear chamber, 0 for the front one."""
    side: Array
    """Sign of the pressure, which it keeps while a step lasts."""

    @property
    def filling(self) -> Array:
        """Whether |p| grows."""
        return self.side * (self.p_set - self.p) >= 0.0


class Flow(Effect):
    """What changes the flow into a chamber."""

    @abstractmethod
    def rate(self, rate: Array, x: Chamber) -> Array:
        """dp/dt [Pa/s] from that of the model without the effect.

        It may differ between filling and venting; steps are split where p passes through zero.
        """

    def replaces(self) -> Array | bool:
        """Whether the lag has no say in the rate."""
        return False


class ActingPressure(Effect):
    """Between the pressure at the sensor and the pressure that bends the body; may remember."""

    @abstractmethod
    def act(
        self, p: Float[Array, "2"], memory: Float[Array, "2 2"], dt: Array
    ) -> tuple[Array, Array]:
        """Acting pressures (2,) [Pa] of front and rear at `p`, `dt` [s] later, and the new memory.

        `memory` is the effect's own state (2,) and the pressure (2,) it was given before; both are
        the pressure at the start. An effect without memory hands it back.
        """


class WaterMotion(Effect):
    """Motion of the water that the body does not make."""

    @abstractmethod
    def velocity(self, t: Array) -> tuple[Array, Array]:
        """(U_x, U_y) [m/s] at `t` [s], uniform along the body."""


class Readings(NamedTuple):
    """What the sensors read, on the evenly spaced times of a rollout; each (n,)."""

    t: Array
    """[s]"""
    p_front: Array
    """[Pa]"""
    p_rear: Array
    """[Pa]"""
    thrust: Array
    """[N]"""
    recoil: Array
    """[N]"""
    tip: Array
    """[m]"""


class Instrument(Effect):
    """What a sensor makes of what it measures."""

    @abstractmethod
    def read(self, true: Readings) -> Readings:
        """What is recorded when `true` is there; t stays."""


def of_place(effects: tuple[Effect, ...], place: type) -> tuple:
    """The effects that enter at a place, in order."""
    return tuple(effect for effect in effects if isinstance(effect, place))


def total_force(effects: tuple[Effect, ...], x: Section) -> tuple[Array, Array]:
    """Sum of the effects' force densities [N/m]."""
    zero = jnp.zeros_like(x.V_n)
    parts = [effect.force(x) for effect in of_place(effects, ForceDensity)]
    return sum((p[0] for p in parts), zero), sum((p[1] for p in parts), zero)
