"""Base classes of the effects. An effect is one physical cause, with parameters and one method.

A model contains a list of effects, and the solver treats all effects alike. Every effect enters the
model at one of the places below. Each place is a class with one abstract method. `parameter`
declares a parameter of an effect, with the null at which the effect vanishes, the prior range and
the reason for this range.
"""

import math
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
    """Prior range of a parameter, `low` to `high`; the effect vanishes at `null`.

    `start` is the value at which the loop first tries the effect. Thresholds, limits and replaced
    laws need a start, because the derivative at the null does not predict the full effect.
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
    """Returns the field of an effect's parameter with this `Prior`. The default is the null."""
    return eqx.field(default=null, metadata={"prior": Prior(null, low, high, unit, why, start)})


class Effect(eqx.Module):
    """One physical cause. Its docstring gives the equation and the source."""

    title: ClassVar[str] = ""
    """Name of the effect in reports."""
    order: ClassVar[float] = math.inf
    """Position in lists and rankings. Effects without a position are last, sorted by name."""
    sensors: ClassVar[tuple[str, ...]] = ("thrust", "recoil", "tip")
    """Sensors that can detect the effect: any of pressure, thrust, recoil and tip."""
    in_every_model: ClassVar[bool] = False
    """Whether every model contains the effect. Such an effect is not in the library."""
    is_candidate: ClassVar[bool] = True
    """Whether the loop may add the effect to explain a residual. False if the effect cannot occur
    in a horizontal tank with a clamped head."""
    rear_only: ClassVar[bool] = False
    """Whether the effect acts only on the rear chamber. A pressure log cannot show the effect."""
    lacks_weight: ClassVar[bool] = False
    """Whether the effect adds inertia without weight. Simulations of climbing in air exclude it."""
    resists_axially: ClassVar[bool] = False
    """Whether the effect is a force density that resists axial motion, which is false for normal
    drag and added mass."""
    replaces_law: ClassVar[str] = ""
    """Part of the model that the effect replaces, or empty. A model may contain only one effect for
    each part."""

    @classmethod
    def name(cls) -> str:
        """Returns the class's name in lower case with underscores, as in files and reports."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    @classmethod
    def place(cls) -> str:
        """Returns the name of the base class for the place where the effect enters the model."""
        return next(kind.__name__ for kind in cls.__mro__[1:] if kind.__module__ == __name__)

    @classmethod
    def priors(cls) -> dict[str, Prior]:
        """Returns the priors of the parameters that can be identified, by parameter name."""
        return {f.name: f.metadata["prior"] for f in fields(cls) if "prior" in f.metadata}


class ForceDensity(Effect):
    """A force per length on the body."""

    in_air: ClassVar[bool] = False
    """Whether the force also acts in air."""

    @abstractmethod
    def force(self, x: Section) -> tuple[Array, Array]:
        """Returns the force per length (F_tau, F_n) [N/m] on a section of the body."""


class BendingMoment(Effect):
    """An internal moment, added to the elastic and viscous moments; it may have memory."""

    @abstractmethod
    def moment(self, x: Section, memory: Array, dt: Array) -> tuple[Array, Array]:
        """Returns the moment (cells,) [N m] and the memory (cells,) at the end of the stage.

        The moment has the sign of EI kappa. The time derivative of the effect's state is
        (value - memory)/dt, and the new value must follow from the section in closed form. An
        effect without memory returns `memory` unchanged.
        """


MOUNT_LAG = 1e-3
"""Time constant [s] of a mounting, which is a spring of compliance c parallel to a dashpot.

The displacement x satisfies x + MOUNT_LAG dx/dt = -c load. The loss factor is 0.03 at 5 Hz, which
is typical of bolted joints. The dashpot also bounds the derivative with respect to c at c = 0."""


class HeadRates(NamedTuple):
    """Rates of the load on the head, filtered with the time constant `MOUNT_LAG`."""

    T_t: Array
    """dT/dt [N/s]"""
    N_t: Array
    """dN/dt [N/s]"""
    M_t: Array
    """dM/dt [N m/s]"""


class Mounting(Effect):
    """A compliance between carriage and head."""

    @abstractmethod
    def give(self, rates: HeadRates) -> tuple[Array, Array, Array]:
        """Returns the head's (V_tau, V_n) [m/s] and omega [rad/s] relative to the carriage."""


class BodyChange(Effect):
    """A difference between the body and its measured parameters."""

    @abstractmethod
    def change(self, robot: Robot) -> Robot:
        """Returns the actual robot, given the measured robot."""


class Command(Effect):
    """A change of the set pressure before the valves act on it."""

    sensors = ("pressure", *Effect.sensors)

    @abstractmethod
    def command(self, wave: Waveform, chamber: int) -> Waveform:
        """Returns the waveform that the valves follow; `chamber` is 0 for front, 1 for rear."""


class Chamber(NamedTuple):
    """State of the chambers and their valves at one instant; entries are (2,), front and rear."""

    p: Array
    """Pressure [Pa]."""
    p_set: Array
    """Set pressure [Pa]."""
    k: Array
    """Time constant [s] of the lag, a scalar."""
    rear: np.ndarray
    """1 for the rear chamber, 0 for the front chamber."""
    side: Array
    """Sign of the pressure; it is constant during a step."""

    @property
    def filling(self) -> Array:
        """Whether |p| increases."""
        return self.side * (self.p_set - self.p) >= 0.0


class Flow(Effect):
    """A change of the flow into a chamber."""

    sensors = ("pressure", *Effect.sensors)

    @abstractmethod
    def rate(self, rate: Array, x: Chamber) -> Array:
        """Returns dp/dt [Pa/s], given the `rate` [Pa/s] of the model without the effect.

        The rate may differ between filling and venting, because steps are split where p is zero.
        """

    def replaces(self) -> Array | bool:
        """Returns whether the effect's rate replaces the rate of the lag."""
        return False


class ActingPressure(Effect):
    """A difference between the measured pressure and the pressure that bends the body."""

    @abstractmethod
    def act(
        self, p: Float[Array, "2"], memory: Float[Array, "2 2"], dt: Array
    ) -> tuple[Array, Array]:
        """Returns the acting pressures (2,) [Pa] of front and rear after `dt` [s], and the memory.

        `memory` contains the effect's state (2,) and the previous pressure (2,). At the start, both
        equal the pressure. An effect without memory returns `memory` unchanged.
        """


class WaterMotion(Effect):
    """Motion of the water that the body does not cause."""

    @abstractmethod
    def velocity(self, t: Array) -> tuple[Array, Array]:
        """Returns the water velocity (U_x, U_y) [m/s] at `t` [s], uniform along the body."""


class Readings(NamedTuple):
    """Sensor readings at the evenly spaced times of a rollout; each entry is (n,)."""

    t: Array
    """Time [s]."""
    p_front: Array
    """Front pressure [Pa]."""
    p_rear: Array
    """Rear pressure [Pa]."""
    thrust: Array
    """Thrust [N]."""
    recoil: Array
    """Recoil [N]."""
    tip: Array
    """Lateral position [m] of the tail tip relative to the head."""


class Instrument(Effect):
    """An error of a sensor."""

    @abstractmethod
    def read(self, true: Readings) -> Readings:
        """Returns the recorded readings from the `true` readings; `t` is unchanged."""

    def read_sample(self, true: Readings, read: Readings) -> Readings:
        """Returns the recorded reading (scalars) of the last sample of `true`.

        `read` contains the recorded readings of the previous samples. An instrument whose reading
        depends on its previous readings must override this method.
        """
        return last_sample(self.read(true))


def last_sample(readings: Readings) -> Readings:
    """Returns the last sample of a series, as scalars."""
    return Readings(*(x[-1] for x in readings))


def of_place(effects: tuple[Effect, ...], place: type) -> tuple:
    """Returns the effects that enter the model at `place`, in their order."""
    return tuple(effect for effect in effects if isinstance(effect, place))


def total_force(effects: tuple[Effect, ...], x: Section) -> tuple[Array, Array]:
    """Returns the sum (F_tau, F_n) of the effects' force densities [N/m]."""
    zero = jnp.zeros_like(x.V_n)
    parts = [effect.force(x) for effect in of_place(effects, ForceDensity)]
    return sum((p[0] for p in parts), zero), sum((p[1] for p in parts), zero)
