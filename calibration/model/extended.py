"""The extended model: the base model and candidate effects, with all parameters in one vector.

One compiled program can fit every candidate, because an effect at its null has no influence. The
tangent for a parameter is one Jacobian-vector product (JVP) along the entry of this parameter.
"""

from collections.abc import Hashable, Sequence
from dataclasses import fields, replace
from enum import Enum
from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.actuation import FirstOrderLag
from slider_jax.channels import ChannelSet
from slider_jax.dynamics.model import Model
from slider_jax.effects import (
    ActingPressure,
    Command,
    Effect,
    Flow,
    Instrument,
    NormalDrag,
    Prior,
    ReactiveForce,
)
from slider_jax.effects.library import KNOWN_EFFECTS, LIBRARY
from slider_jax.experiment.load import Experiment, drag_and_added_mass

BASE = {
    "C_d": Prior(np.nan, 0.0, 12.0, "-", "2 for a plate in steady flow, more for small motions"),
    "m_a": Prior(np.nan, 0.0, 2.0, "-", "1 for a thin plate in potential flow"),
    "k": Prior(np.nan, 0.005, 0.5, "s", "valves and hoses of pneumatic rigs"),
    "K_Q": Prior(np.nan, 1e-8, 1e-5, "m^3", "area times lever arm of an air chamber"),
}
"""Parameters of the base model that a calibration identifies, and the search range of each."""


class Parameter(NamedTuple):
    """An entry of the parameter vector. `effect` is "" for a parameter of the base model."""

    effect: str
    name: str
    prior: Prior
    is_shape: bool = False
    """Whether the entry is a shape parameter; `prior.null` is then the parameter's default."""

    @property
    def label(self) -> str:
        return f"{self.effect}.{self.name}" if self.effect else self.name


def model_parameters(effects: Sequence[str]) -> list[Parameter]:
    """Returns the entries of the parameter vector: first the base model, then the `effects`.

    The shape parameters of an effect follow the effect's other parameters.
    """
    return list(_parameters(tuple((name, KNOWN_EFFECTS[name]) for name in effects)))


@lru_cache(maxsize=64)
def _parameters(effects: tuple[tuple[str, type[Effect]], ...]) -> tuple[Parameter, ...]:
    """Returns `model_parameters`; each simulation needs them, and making them takes 0.5 ms."""
    found = [Parameter("", name, prior) for name, prior in BASE.items()]
    for effect, kind in effects:
        found += [Parameter(effect, name, prior) for name, prior in kind.priors().items()]
        found += [Parameter(effect, name, prior, True) for name, prior in kind.shapes().items()]
    return tuple(found)


def acting_entries(entries: Sequence[Parameter], theta: np.ndarray) -> np.ndarray:
    """Returns the indices of all entries except the shape parameters of effects at their null.

    These shape parameters have no influence on the readings.
    """
    present = {p.effect for p, x in zip(entries, theta, strict=True) if _is_moved(p, x)}
    return np.array([i for i, p in enumerate(entries) if not p.is_shape or p.effect in present])


def tangent_entries(entries: Sequence[Parameter], theta: np.ndarray) -> np.ndarray:
    """Returns the indices of the entries whose tangents the loop needs.

    These are the `acting_entries`, except the entries of effects that are at their null and have a
    `Prior.start`: the loop scores these effects by secants.
    """
    present = {p.effect for p, x in zip(entries, theta, strict=True) if _is_moved(p, x)}
    started = {p.effect for p in entries if p.prior.start is not None} - present
    return np.array([i for i in acting_entries(entries, theta) if entries[i].effect not in started])


def _is_moved(p: Parameter, value: float) -> bool:
    """Returns whether the value of an effect's parameter makes the effect act."""
    return bool(p.effect) and not p.is_shape and value != p.prior.null


def candidate_effects() -> list[str]:
    """Returns the names of all effects that the loop may add to the model."""
    return [name for name, kind in LIBRARY.items() if kind.is_candidate]


class ExtendedModel(eqx.Module):
    """The base model of a trial, and candidate effects."""

    base: Model
    conditions: dict[str, Array]
    """Values of the trial, such as the tow speed. Each key is the name of a field of an effect."""
    effects: tuple[str, ...] = eqx.field(static=True)
    channels: ChannelSet = eqx.field(static=True)

    def at(self, theta: Float[Array, " parameters"]) -> Model:
        """Returns the model with the parameters of the vector `theta`, in SI units."""
        values = dict(
            zip(((p.effect, p.name) for p in model_parameters(self.effects)), theta, strict=True)
        )
        drag, reactive, *rest = self.base.effects
        assert isinstance(drag, NormalDrag) and isinstance(reactive, ReactiveForce)
        law = self.base.pressure_law
        if isinstance(law, FirstOrderLag):
            law = replace(law, k=values["", "k"])
        return replace(
            self.base,
            robot=replace(self.base.robot, K_Q=values["", "K_Q"]),
            pressure_law=law,
            effects=(
                replace(drag, C_d=values["", "C_d"]),
                replace(reactive, m_a=values["", "m_a"]),
                *rest,
                *(self._effect(name, values) for name in self.effects),
            ),
        )

    def _effect(self, name: str, values) -> Effect:
        kind = KNOWN_EFFECTS[name]
        given = {p: values[name, p] for p in kind.priors() | kind.shapes()}
        known = {f.name for f in fields(kind)}
        return kind(**{n: x for n, x in self.conditions.items() if n in known} | given)


def base_vector(entries: Sequence[Parameter], base: dict[str, float]) -> np.ndarray:
    """Returns the parameter vector with the base parameters `base` and every effect at its null.

    Shape parameters have their defaults.
    """
    return np.array([p.prior.null if p.effect else base[p.name] for p in entries])


def base_values(experiment: Experiment) -> dict[str, float]:
    """Returns the base parameters of an experiment. C_d and m_a are averaged over the trials."""
    C_d, m_a = np.mean([drag_and_added_mass(experiment, t) for t in experiment.trials], axis=0)
    fixed = {"C_d": float(C_d), "m_a": float(m_a)}
    return {n: fixed[n] if n in fixed else getattr(experiment.parameters, n) for n in BASE}


class Part(Enum):
    """Parts of a model that are simulated one after the other."""

    PRESSURES = "pressures"
    BODY = "robot and water"
    SENSORS = "sensors"

    @classmethod
    def of_kind(cls, kind: type[Effect]) -> "Part":
        """Returns the part in which effects of a class act."""
        if issubclass(kind, Command | Flow | ActingPressure):
            return cls.PRESSURES
        return cls.SENSORS if issubclass(kind, Instrument) else cls.BODY


class PartialModel(NamedTuple):
    """An extended model with the effects of one part."""

    extended: ExtendedModel
    theta: np.ndarray
    """Parameters of the base model and of these effects."""
    entries: np.ndarray
    """Indices of `theta` in the parameter vector of the model with all effects."""

    @property
    def model(self) -> Model:
        return self.extended.at(jnp.asarray(self.theta))

    @property
    def has_effects(self) -> bool:
        """Returns whether effects of the library, or of the experiment file, act in this part."""
        drag_and_reactive_force = 2
        return bool(self.extended.effects) or (
            len(self.extended.base.effects) > drag_and_reactive_force
        )

    @property
    def pressure_key(self) -> Hashable:
        """Returns the effects, and all parameters that can change the pressures."""
        own = [list(BASE).index("k"), *range(len(BASE), len(self.theta))]
        return self.extended.effects, self.theta[own].tobytes()


def acting_part(
    extended: ExtendedModel, part: Part, theta: np.ndarray, directions: np.ndarray | None = None
) -> PartialModel:
    """Returns the model with the effects of a part; without effects if all are at their null.

    The effects stay if one of the `directions` (k, entries) changes a parameter of an effect. The
    loop scores effects with a `Prior.start` by secants, and their laws take the most time. With
    `directions`, the model therefore omits these effects if all of them are at their null and no
    direction changes them. The readings are those of the model with all effects. A program without
    effects takes about half the time of one with all effects.
    """
    acting, started = set(), set()
    for i, p in enumerate(model_parameters(extended.effects)):
        changed = directions is not None and directions[:, i].any()
        if _is_moved(p, theta[i]) or (changed and p.effect):
            acting.add(p.effect)
        if p.prior.start is not None:
            started.add(p.effect)
    names = _names(extended, part)
    if acting.isdisjoint(names):
        return _with_effects(extended, part, theta, [])
    omitted = started.intersection(names)
    if directions is None or not acting.isdisjoint(omitted):
        omitted = set()
    return _with_effects(extended, part, theta, [n for n in names if n not in omitted])


def is_at_null(extended: ExtendedModel, theta: np.ndarray) -> bool:
    """Returns whether all effects of the model are at their null."""
    return not any(map(_is_moved, model_parameters(extended.effects), theta))


def changed_part(
    extended: ExtendedModel, part: Part, theta: np.ndarray, directions: np.ndarray
) -> PartialModel:
    """Returns the model with the effects of a part that `directions` (k, entries) change.

    Requires that all effects are at their null (`is_at_null`): an omitted effect must not act. The
    time of a direction grows with the number of effects in the model, but every set of effects
    needs a program of its own.
    """
    entries = model_parameters(extended.effects)
    acting = {entries[i].effect for i in np.flatnonzero(directions.any(axis=0))}
    names = [name for name in _names(extended, part) if name in acting]
    return _with_effects(extended, part, theta, names)


def whole_part(extended: ExtendedModel, part: Part, theta: np.ndarray) -> PartialModel:
    """Returns the model with all effects of a part, and without the effects of the other parts."""
    return _with_effects(extended, part, theta, _names(extended, part))


def _names(extended: ExtendedModel, part: Part) -> list[str]:
    return [n for n in extended.effects if Part.of_kind(KNOWN_EFFECTS[n]) is part]


def _with_effects(
    extended: ExtendedModel, part: Part, theta: np.ndarray, names: Sequence[str]
) -> PartialModel:
    """Returns a part of the model with the effects `names` of the library."""
    effects = [p.effect for p in model_parameters(extended.effects)]
    entries = np.flatnonzero([not name or name in names for name in effects])
    drag, reactive, *rest = extended.base.effects
    own = (drag, reactive, *(x for x in rest if Part.of_kind(type(x)) is part))
    base = replace(extended.base, effects=own)
    return PartialModel(replace(extended, base=base, effects=tuple(names)), theta[entries], entries)
