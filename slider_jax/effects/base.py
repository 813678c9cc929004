"""Base classes of the effects. An effect models one physical cause.

A model contains a list of effects, and the solver treats all effects alike. A place is the part of
the model where an effect acts. This module defines one base class with one abstract method for each
place. `parameter` declares a parameter of an effect: the null at which the effect vanishes, the
prior range and the reason for this range. `shape_parameter` declares a parameter that sets the
shape of the law, such as a time constant; this parameter has no null.
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
from slider_jax.beam.spatial import SpatialLoad, SpatialSection, no_load


class Prior(NamedTuple):
    """Prior range of a parameter from `low` to `high`, with the reason `why` for this range.

    The effect vanishes at `null`. `start` is the value at which the loop (the search for missing
    effects) first tests the effect. An effect needs a start if the derivative at the null does not
    predict its influence, for example a deadband, a hard limit or a law that replaces the lag.
    `physical` are the lowest and highest value that the law allows. The loop may widen the prior
    range up to these limits, and never beyond an end that is the null.
    """

    null: float
    low: float
    high: float
    unit: str
    why: str
    start: float | None = None
    physical: tuple[float, float] = (-math.inf, math.inf)


def parameter(
    null: float,
    low: float,
    high: float,
    unit: str,
    why: str,
    start: float | None = None,
    physical: tuple[float, float] = (-math.inf, math.inf),
) -> Any:
    """Returns a field for a parameter of an effect. The field's default value is `null`."""
    prior = Prior(null, low, high, unit, why, start, physical)
    return eqx.field(default=null, metadata={"prior": prior})


def shape_parameter(
    value: float,
    low: float,
    high: float,
    unit: str,
    why: str,
    physical: tuple[float, float] = (-math.inf, math.inf),
) -> Any:
    """Returns a field for a shape parameter of an effect. The field's default value is `value`.

    A shape parameter has no null. Its value has an influence only if the other parameters of the
    effect differ from their nulls. The loop therefore fits it only after the effect is added.
    """
    prior = Prior(value, low, high, unit, why, None, physical)
    return eqx.field(default=value, metadata={"shape": prior})


class Curve(NamedTuple):
    """Texts on the function that a term of the dictionary adds to the model, for reports."""

    state: str
    """Name of the local state on which the function depends."""
    unit: str
    """Unit of the state."""
    value: str
    """Name of the function's value."""
    value_unit: str
    """Unit of the value."""


class Effect(eqx.Module):
    """A physical cause. Each subclass states its equation and its source in its docstring."""

    title: ClassVar[str] = ""
    """Name of the effect in reports."""
    order: ClassVar[float] = math.inf
    """Position of the effect in the library. Effects without a number are last, sorted by name."""
    sensors: ClassVar[tuple[str, ...]] = ("thrust", "recoil", "tip")
    """Sensors that can detect the effect: one or more of pressure, thrust, recoil and tip."""
    segments: ClassVar[tuple[str, ...]] = ()
    """Parts of the robot that an effect of the body changes: body, tail or both. The tuple is empty
    for effects at other places, such as valves, mounting, water and sensors."""
    in_every_model: ClassVar[bool] = False
    """Whether every model contains the effect. If True, the library omits the effect."""
    is_candidate: ClassVar[bool] = True
    """Whether the loop may add the effect to explain a residual. The value is False if the effect
    cannot act on a horizontal robot with a clamped head in a tank."""
    rear_only: ClassVar[bool] = False
    """Whether the effect is a difference between chambers. Fits to pressure logs omit it."""
    lacks_weight: ClassVar[bool] = False
    """Whether the effect adds inertia without weight. Climbing simulations exclude such effects."""
    resists_axially: ClassVar[bool] = False
    """Whether the effect is a force density that resists axial motion. Normal drag and added mass
    do not resist axial motion."""
    term_curve: ClassVar[Curve | None] = None
    """Texts on the function of a term of the dictionary. It is None for physical effects."""
    replaces_law: ClassVar[str] = ""
    """Part of the model that the effect replaces, or "". Two effects must not replace one part."""

    def vertical(self) -> Float[Array, "3"] | None:
        """Returns g times the upward unit vector (x, y, z) [m/s^2]; None without weight."""
        return None

    needed_in_space: ClassVar[tuple[str, ...]] = ()
    """Fields that an experiment file with dimension = 3 must state."""
    needs_density: ClassVar[tuple[str, ...]] = ()
    """Fields that act only on a robot with a density, and so with a displaced volume."""

    @classmethod
    def name(cls) -> str:
        """Returns the class's name in lower case with underscores, as in files and reports."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    @classmethod
    def place(cls) -> str:
        """Returns the name of the effect's place: the name of a base class, such as `Flow`."""
        return next(kind.__name__ for kind in cls.__mro__[1:] if kind.__module__ == __name__)

    @classmethod
    def priors(cls) -> dict[str, Prior]:
        """Returns the priors of the parameters that a fit can identify, by parameter name."""
        return {f.name: f.metadata["prior"] for f in fields(cls) if "prior" in f.metadata}

    @classmethod
    def shapes(cls) -> dict[str, Prior]:
        """Returns the shape parameters by name. The `null` of each entry is its default value."""
        return {f.name: f.metadata["shape"] for f in fields(cls) if "shape" in f.metadata}


class ForceDensity(Effect):
    """A force per length on the body."""

    in_air: ClassVar[bool] = False
    """Whether the force also acts in air."""

    @abstractmethod
    def force(self, x: Section) -> tuple[Array, Array]:
        """Returns the force per length (F_tau, F_n) [N/m] on a section of the body.

        Above a waterline, the water exerts no force: `total_force` multiplies the force of an
        effect that is not `in_air` by the wet fraction of the section.
        """

    def entrained_mass(self, x: Section) -> Array:
        """Returns the mass per length [kg/m] of the water that moves with a wet section.

        An effect that gives momentum to the water must override this method.
        """
        return jnp.zeros_like(x.V_n)

    def entry_force(self, x: Section) -> tuple[Array, Array]:
        """Returns the force per length (F_tau, F_n) [N/m] due to the motion through the surface.

        Only models with a waterline have this force, and it is not multiplied by the wet fraction.
        See `ReactiveForce`.
        """
        zero = jnp.zeros_like(x.V_n)
        if x.wetting is None:
            return zero, zero
        return zero, -self.entrained_mass(x) * jnp.maximum(x.wetting, 0.0) * x.u_n

    def load_in_space(self, x: SpatialSection) -> SpatialLoad:
        """Returns force and couple per length on a section of a body in space.

        In the plane, the force must equal `force`. Raises `NotImplementedError` for an effect that
        is defined in the plane only; `in_space` tells whether the effect has this method.
        """
        raise NotImplementedError(f"{self.name()} is defined in the plane only")


class WakeForce(Effect):
    """A force per length on the body that depends on the past motion of each section.

    With a waterline, the solver multiplies the force by the wet fraction of the section.
    """

    states: ClassVar[int] = 1
    """Number of states of the effect in each cell."""

    @abstractmethod
    def wake_force(
        self, x: Section, memory: Float[Array, "states cells"], dt: Array
    ) -> tuple[tuple[Array, Array], Float[Array, "states cells"]]:
        """Returns the force per length (F_tau, F_n) [N/m] and the states q after the stage.

        In the stage, dq/dt is (q - `memory`)/`dt`. The method must solve the equations of q in
        closed form. The states of a body at rest are 0.
        """


class BendingMoment(Effect):
    """An internal moment, added to the elastic and viscous moments."""

    @abstractmethod
    def moment(self, x: Section, memory: Array, dt: Array) -> tuple[Array, Array]:
        """Returns the moment (cells,) [N m] and the effect's state q (cells,) after the stage.

        A positive moment acts like the elastic moment EI kappa of a positive curvature. In the
        stage, dq/dt is (q - `memory`)/`dt`. The method must solve the equation of q in closed form.
        An effect without a state returns `memory` unchanged.
        """


MOUNT_LAG = 1e-3
"""Time constant [s] of a mounting, which is a spring of compliance c parallel to a dashpot.

The displacement x under a load satisfies x + MOUNT_LAG dx/dt = -c load. The loss factor is 0.03 at
5 Hz, which is typical of bolted joints. The dashpot also bounds the derivative of the readings with
respect to c at c = 0."""


class HeadRates(NamedTuple):
    """Time derivatives of the loads on the head, filtered with the time constant `MOUNT_LAG`."""

    T_t: Array
    """dT/dt [N/s] of the axial force T."""
    N_t: Array
    """dN/dt [N/s] of the shear force N."""
    M_t: Array
    """dM/dt [N m/s] of the bending moment M."""


class Mounting(Effect):
    """A compliance between carriage and head."""

    @abstractmethod
    def give(self, rates: HeadRates) -> tuple[Array, Array, Array]:
        """Returns the head's V_tau, V_n [m/s] and omega [rad/s], all relative to the carriage."""


class BodyChange(Effect):
    """A difference between actual and measured parameters of the body."""

    serves_space: ClassVar[bool] = False
    """Whether the change has the same meaning for a body in space, and not only for bending about
    b."""

    @abstractmethod
    def change(self, robot: Robot) -> Robot:
        """Returns the robot with actual properties; `robot` has the measured properties."""


class Command(Effect):
    """Set pressure: the valves receive another set pressure than the commanded one."""

    sensors = ("pressure", *Effect.sensors)

    @abstractmethod
    def command(self, wave: Waveform, rear: Array) -> Waveform:
        """Returns the waveform at a chamber's valves for a command `wave`; `rear` is `rear_of`."""


def mean_of_others(values: Float[Array, "... chambers"]) -> Float[Array, "... chambers"]:
    """Returns the mean of the other chambers' values, which is 0 if there is only one chamber."""
    chambers = values.shape[-1]
    return values @ ((1.0 - np.eye(chambers)) / max(chambers - 1, 1))


class Chamber(NamedTuple):
    """State of chambers and valves at one instant. The last axis is the chambers."""

    p: Array
    """Pressure [Pa]."""
    p_set: Array
    """Set pressure [Pa]."""
    k: Array
    """Time constant [s] of the lag: a scalar, or the time constant of each chamber."""
    rear: np.ndarray
    """Order of the chambers, from `rear_of`."""
    side: Array
    """Sign of the pressure; the sign is constant during a Runge-Kutta step."""
    states: Array
    """States (states, chambers) of the effect that reads these chambers."""

    @property
    def filling(self) -> Array:
        """Whether the chambers fill, so that |p| increases."""
        return self.side * (self.p_set - self.p) >= 0.0


class Flow(Effect):
    """A change of the flow into a chamber.

    An effect with memory has `states`, for example the opening of a slow valve.
    """

    sensors = ("pressure", *Effect.sensors)
    states: ClassVar[int] = 0
    """Number of states of the effect in each chamber."""

    @abstractmethod
    def rate(self, rate: Array, x: Chamber) -> Array:
        """Returns dp/dt [Pa/s] with the effect; `rate` is dp/dt [Pa/s] without the effect.

        The result may jump only where p changes its sign, because the solver splits a step there.
        """

    def replaces(self) -> Array | bool:
        """Returns whether the effect replaces the first-order lag of the pressure."""
        return False

    def start(self, p: Float[Array, " chambers"]) -> Float[Array, "states chambers"]:
        """Returns the states in equilibrium at the pressures `p` [Pa]."""
        return jnp.zeros((self.states, *jnp.shape(p)))

    def state_rates(self, rate: Array, x: Chamber) -> Float[Array, "states chambers"]:
        """Returns the time derivatives of the states; `rate` is the argument of `rate`.

        An effect with `states` must override this method.
        """
        if self.states:
            raise NotImplementedError(f"{self.name()} has states, but no method state_rates")
        return x.states


class ActingPressure(Effect):
    """A difference between the measured pressure and the pressure that bends the body."""

    @abstractmethod
    def act(
        self, p: Float[Array, " chambers"], memory: Float[Array, "2 chambers"], dt: Array
    ) -> tuple[Array, Array]:
        """Returns the pressures [Pa] that bend the body at the end of a step, and the memory.

        `p` is the pressure [Pa] of each chamber at the end of the step `dt` [s]. The rows of
        `memory` are a state and the pressure before the step. At the start of a simulation, both
        rows are the pressure. An effect without a state returns `memory` unchanged.
        """


class WaterMotion(Effect):
    """Motion of the water that the body does not cause."""

    @abstractmethod
    def velocity(self, t: Array) -> tuple[Array, Array]:
        """Returns the water velocity (U_x, U_y) [m/s] at `t` [s], uniform along the body."""


class Readings(NamedTuple):
    """Sensor readings at n evenly spaced times; the last axis of each field is the time."""

    t: Array
    """Time [s]."""
    pressures: Float[Array, "chambers n"]
    """Pressure [Pa] of each chamber."""
    thrust: Array
    """Thrust [N]."""
    recoil: Array
    """Recoil [N]."""
    tip: Array
    """Lateral position [m] of the tail's tip relative to the head."""


class Instrument(Effect):
    """An error of a sensor."""

    @abstractmethod
    def read(self, true: Readings) -> Readings:
        """Returns the readings that the sensors record instead of the `true` readings."""

    def read_sample(self, true: Readings, read: Readings) -> Readings:
        """Returns the readings that the sensors record for the last sample of `true`.

        `read` contains the recorded readings of the previous samples. An instrument must override
        this method if a recorded reading depends on previously recorded readings.
        """
        return last_sample(self.read(true))


def last_sample(readings: Readings) -> Readings:
    """Returns the last sample of a series, without the axis of the time."""
    return Readings(*(x[..., -1] for x in readings))


def of_place(effects: tuple[Effect, ...], place: type) -> tuple:
    """Returns the `effects` whose base class is `place`, in the same order."""
    return tuple(effect for effect in effects if isinstance(effect, place))


def in_space(effect: Effect | type[Effect]) -> bool:
    """Returns whether a model in three dimensions may contain the effect, or the class of effects.

    Effects of pressures and sensors act alike in two and in three dimensions.
    """
    kind = effect if isinstance(effect, type) else type(effect)
    if issubclass(kind, ForceDensity):
        return kind.load_in_space is not ForceDensity.load_in_space
    if issubclass(kind, BodyChange):
        return kind.serves_space
    return issubclass(kind, (Command, Flow, ActingPressure, Instrument))


def states_at_rest(effects: tuple[Effect, ...], cells: Array) -> tuple[Array, ...]:
    """Returns the state at rest of each effect with a state in the cells.

    The effects of the place `WakeForce` are first, then those of the place `BendingMoment`. The
    states have the precision and the last axis of `cells`.
    """
    zero = jnp.zeros_like(cells)
    wakes = (jnp.zeros((e.states, *zero.shape), zero.dtype) for e in of_place(effects, WakeForce))
    return (*wakes, *(zero for _ in of_place(effects, BendingMoment)))


def total_load(effects: tuple[Effect, ...], x: SpatialSection) -> SpatialLoad:
    """Returns the sum of the effects' loads per length in space."""
    total = no_load(x)
    for effect in of_place(effects, ForceDensity):
        load = effect.load_in_space(x)
        total = SpatialLoad(total.force.plus(load.force), total.couple.plus(load.couple))
    return total


def force_of(effect: ForceDensity, x: Section) -> tuple[Array, Array]:
    """Returns the force density (F_tau, F_n) [N/m] of an effect on the wet part of the section.

    An effect that is `in_air` acts on the whole section.
    """
    F_tau, F_n = effect.force(x)
    if x.wet is None or effect.in_air:
        return F_tau, F_n
    entry_tau, entry_n = effect.entry_force(x)
    return x.wet * F_tau + entry_tau, x.wet * F_n + entry_n


def total_force(effects: tuple[Effect, ...], x: Section) -> tuple[Array, Array]:
    """Returns the sum (F_tau, F_n) of the effects' force densities [N/m]."""
    zero = jnp.zeros_like(x.V_n)
    parts = [force_of(effect, x) for effect in of_place(effects, ForceDensity)]
    return sum((p[0] for p in parts), zero), sum((p[1] for p in parts), zero)
