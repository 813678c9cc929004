"""Checks the effects of a file before the library contains them.

A place's method is evaluated on a small sample input: in motion, and at rest. The values and their
derivatives must be finite, and at the null the effect must change nothing.
"""

import inspect
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slider_jax.actuation.waveform import SquareWave, Waveform, rear_of
from slider_jax.beam.equations import Section
from slider_jax.beam.parameters import uniform_robot
from slider_jax.effects.base import (
    ActingPressure,
    BendingMoment,
    BodyChange,
    Chamber,
    Command,
    Effect,
    Flow,
    ForceDensity,
    HeadRates,
    Instrument,
    Mounting,
    Readings,
    WakeForce,
    WaterMotion,
    last_sample,
)
from slider_jax.errors import InputError

SENSORS, SEGMENTS = ("pressure", "thrust", "recoil", "tip"), ("body", "tail")
"""Allowed entries of an effect's attributes `sensors` and `segments`."""
DT = 2e-3
"""Time step [s] of the samples."""
CHAMBERS = 2
"""Number of chambers in the samples of pressures."""


class Response(NamedTuple):
    """Values that a method returns on a sample input, and values that it must return at the null.

    If a method also returns the effect's state, this state must be an array like `memory`.
    """

    given: Any
    unchanged: Any
    state: Any = ()
    memory: Any = ()


CELLS = np.arange(5.0)
ROBOT = uniform_robot()
STRUCTURE = {
    "linear_density": 0.7, "EI": 0.04, "EA": 1e5, "damping_time": 2e-3, "height": 0.03,
    "height_s": 0.0, "ds": 0.07,
}  # fmt: skip
"""Structure of the sample's cells, in SI units, similar to the paper's robot."""
MOTION = {
    "phi": 0.3, "pressure": 1e5, "kappa": 3.0, "kappa_t": 60.0, "omega": 5.0, "strain": 1e-3,
    "strain_t": 0.02, "V_tau": 0.2, "V_n": 0.5, "V_tau_t": 5.0, "V_n_t": 10.0, "u_tau": 0.3,
    "u_n": 0.5, "u_tau_s": 1.0, "u_n_s": 3.0, "u_tau_t": 5.0, "u_n_t": 10.0,
}  # fmt: skip
"""Largest values in the sample's cells, in SI units. They are typical of a stride at 5 Hz."""


def _section(moving: Array) -> Section:
    fixed = {name: np.full_like(CELLS, x) for name, x in STRUCTURE.items()}
    tail = np.where(CELLS < 2.0, 1.0, 0.0)
    joint = np.where((CELLS == 1.0) | (CELLS == 2.0), 0.5 / STRUCTURE["ds"], 0.0)
    fixed |= {"s": STRUCTURE["ds"] * (CELLS + 0.5), "in_tail": tail, "joint": joint}
    parts = {k: moving * (x * np.cos(i + CELLS)) for i, (k, x) in enumerate(MOTION.items())}
    return Section(**{k: jnp.asarray(x) for k, x in fixed.items()}, **parts, t=0.1 * moving)


def _force(effect: ForceDensity, moving: Array) -> Response:
    zero = jnp.zeros(CELLS.shape)
    return Response(tuple(part + zero for part in effect.force(_section(moving))), (zero, zero))


def _wake_force(effect: WakeForce, moving: Array) -> Response:
    zero = jnp.zeros(CELLS.shape)
    memory = jnp.zeros((effect.states, *CELLS.shape))
    force, state = effect.wake_force(_section(moving), memory, jnp.asarray(DT))
    at_rest = state * (1.0 - moving)  # must be zero
    given = (*(part + zero for part in force), at_rest)
    return Response(given, (zero, zero, memory), state, memory)


def _moment(effect: BendingMoment, moving: Array) -> Response:
    zero = jnp.zeros(CELLS.shape)
    moment, state = effect.moment(_section(moving), zero, jnp.asarray(DT))
    return Response(moment + zero, zero, state, zero)


def _give(effect: Mounting, moving: Array) -> Response:
    rates = HeadRates(30.0 * moving, -20.0 * moving, 2.0 * moving)
    return Response(effect.give(rates), (jnp.zeros(()),) * 3)


def _change(effect: BodyChange, moving: Array) -> Response:
    robot = jax.tree.map(jnp.asarray, ROBOT)
    return Response(effect.change(robot), robot)


def _set_pressures(wave: Waveform) -> Array:
    """Returns the mean and the last set pressure [Pa] of four time steps, two with a break."""
    if not isinstance(wave, Waveform):
        raise TypeError(f"returns {type(wave).__name__}; allowed a Waveform")
    rows = []
    for t0 in (0.0, 0.05, 0.1195, 0.17):
        x = wave.segment(jnp.asarray(t0), jnp.asarray(t0 + DT))
        area = (x.t_break - x.t0) * (x.a0 + x.a1) + (x.t1 - x.t_break) * (x.b0 + x.b1)
        rows += [0.5 * area / DT, x.b1]
    return jnp.stack(rows)


def _command(effect: Command, moving: Array) -> Response:
    wave = SquareWave(jnp.asarray(5.0), 2e5 * moving, jnp.asarray(0.1))
    rows = [_set_pressures(effect.command(wave, rear)) for rear in rear_of(CHAMBERS)]
    return Response(jnp.stack(rows), jnp.stack([_set_pressures(wave)] * CHAMBERS))


def _rate(effect: Flow, moving: Array) -> Response:
    k, rear, given, unchanged = jnp.asarray(0.1), rear_of(CHAMBERS), [], []
    states, memory = [], []
    # Both signs of the pressure, each with one chamber that fills and one that vents.
    for p, p_set in (([0.5e5, 1.2e5], [2e5, 0.2e5]), ([-0.4e5, -1e5], [-2e5, 1e5])):
        x = Chamber(
            moving * np.array(p),
            moving * np.array(p_set),
            k,
            rear,
            jnp.sign(np.array(p)),
            effect.start(moving * np.array(p)),
        )
        rate = (x.p_set - x.p) / k
        given.append(effect.rate(rate, x))
        unchanged.append(rate)
        states.append(effect.state_rates(rate, x))
        memory.append(jnp.zeros((effect.states, CHAMBERS)))
        for method, array in (("start", x.states), ("state_rates", states[-1])):
            if jnp.shape(array) != (effect.states, CHAMBERS):
                raise TypeError(
                    f"{method} returns the shape {jnp.shape(array)}; allowed "
                    f"({effect.states}, {CHAMBERS})"
                )
    replaces = jnp.where(jnp.asarray(effect.replaces()), 1.0, 0.0)
    return Response((given, replaces), (unchanged, jnp.zeros(())), states, memory)


def _act(effect: ActingPressure, moving: Array) -> Response:
    p = moving * np.array([1e5, -0.6e5])
    memory = 0.7 * jnp.stack([p, p])
    acting, state = effect.act(p, memory, jnp.asarray(DT))
    return Response(acting, p, state, memory)


def _velocity(effect: WaterMotion, moving: Array) -> Response:
    return Response(jnp.stack(effect.velocity(0.37 * moving)), jnp.zeros(2))


def _read(effect: Instrument, moving: Array) -> Response:
    t = DT * np.arange(32.0)
    sizes = (2e5, 1.5e5, 0.1, 1.0, 0.02)
    series = [moving * (x * np.sin(i + 30.0 * t)) for i, x in enumerate(sizes)]
    true = Readings(jnp.asarray(t), jnp.stack(series[:CHAMBERS]), *series[CHAMBERS:])
    before, last = Readings(*(x[..., :-1] for x in true)), last_sample(true)
    return Response((effect.read(true), effect.read_sample(true, before)), (true, last))


class Place(NamedTuple):
    """The method that an effect of a place defines, and its evaluation on the sample input.

    The sample moves if the number that `response` receives is 1, and is at rest if it is 0.
    """

    method: str
    response: Callable[[Any, Array], Response]


PLACES: dict[type[Effect], Place] = {
    Command: Place("command", _command),
    Flow: Place("rate", _rate),
    ActingPressure: Place("act", _act),
    BodyChange: Place("change", _change),
    BendingMoment: Place("moment", _moment),
    Mounting: Place("give", _give),
    ForceDensity: Place("force", _force),
    WakeForce: Place("wake_force", _wake_force),
    WaterMotion: Place("velocity", _velocity),
    Instrument: Place("read", _read),
}
"""The places of the model at which an effect acts, in the order from the valves to the sensors."""
PLACE_NAMES = ", ".join(place.__name__ for place in PLACES)


def defined_effects(module: object) -> list[type[Effect]]:
    """Returns the effect classes that `module` defines, including abstract classes."""
    kinds = [x for x in vars(module).values() if isinstance(x, type) and issubclass(x, Effect)]
    return list(dict.fromkeys(x for x in kinds if x.__module__ == vars(module)["__name__"]))


def is_complete(kind: type[Effect]) -> bool:
    """Returns whether the class is derived from a place and defines the place's method."""
    return issubclass(kind, tuple(PLACES)) and not inspect.isabstract(kind)


def checked_effects(module: object, where: str, taken: Mapping[str, str]) -> list[type[Effect]]:
    """Returns the effects that `module` defines. `taken` contains the home of each used name.

    Raises `InputError` if the module defines no effect or an invalid effect. An incomplete class,
    without the method of a place, is allowed only as a base of another class of the module.
    """
    kinds = defined_effects(module)
    if not kinds:
        raise InputError(
            f"{where}: defines no effect; define a class that is derived from a base class of "
            "slider_jax.effects, and define the abstract method of the base class"
        )
    homes = dict(taken)
    for kind in kinds:
        is_base = any(other is not kind and issubclass(other, kind) for other in kinds)
        if is_complete(kind) or not is_base:
            _check_class(kind, f"{where}: {kind.__name__}", homes)
            homes[kind.name()] = where
    found = [kind for kind in kinds if is_complete(kind)]
    for kind in found:
        _check_on_sample(kind, f"{where}: {kind.__name__}")
    return found


def _check_class(kind: type[Effect], where: str, homes: Mapping[str, str]) -> None:
    """Raises `InputError` for a wrong place, name, title, null, prior range or start."""
    places = [place for place in PLACES if issubclass(kind, place)]
    if len(places) != 1:
        given = " and ".join(place.__name__ for place in places) or "no base class of a place"
        raise InputError(
            f"{where}: is derived from {given}; allowed is one of {PLACE_NAMES}; see the table of "
            "places in docs/how-to/adding_an_effect.md"
        )
    if inspect.isabstract(kind):
        method = PLACES[places[0]].method
        missing = ", ".join(sorted(kind.__abstractmethods__))
        others = [p.__name__ for p, x in PLACES.items() if x.method in vars(kind)]
        advice = f", or derive the class from {others[0]}" if others else ""
        raise InputError(
            f"{where}: does not define {missing}; an effect of the place {places[0].__name__} "
            f"defines the method {method}; define it{advice}"
        )
    if issubclass(kind, WakeForce) and kind.resists_axially:
        raise InputError(
            f"{where}.resists_axially: given True; allowed False, because the thrust of a swimmer "
            "is computed from force densities without memory; derive the class from ForceDensity"
        )
    if kind.name() in homes:
        raise InputError(
            f"{where}: the effect {kind.name()!r} exists in {homes[kind.name()]}; change the class "
            "name, and load each file only once"
        )
    if not kind.title:
        raise InputError(f'{where}: has no title; add title = "name of the effect in reports"')
    if not kind.priors():
        raise InputError(
            f"{where}: has no parameter with null and prior range; declare a field with "
            "parameter(null, low, high, unit, why)"
        )
    for noun, priors in (("null", kind.priors()), ("default", kind.shapes())):
        for name, prior in priors.items():
            inside = [prior.null] if prior.start is None else [prior.null, prior.start]
            for x in (prior.low, prior.high, *inside):
                if not (isinstance(x, (int, float)) and math.isfinite(x)):
                    raise InputError.value(f"{where}.{name}", repr(x), "a finite number")
            if prior.start == prior.null:
                raise InputError(
                    f"{where}.{name}: given start {prior.start:g}, equal to the null; allowed is a "
                    "value at which the effect acts; change or omit start"
                )
            if not (prior.low < prior.high and all(prior.low <= x <= prior.high for x in inside)):
                start = "" if prior.start is None else f", start {prior.start:g}"
                raise InputError(
                    f"{where}.{name}: given {noun} {prior.null:g}{start}, prior {prior.low:g} to "
                    f"{prior.high:g}; allowed are low < high, and {noun} and start in this range"
                )
    for name, prior in (kind.priors() | kind.shapes()).items():
        least, most = prior.physical
        if not least <= prior.low < prior.high <= most:
            raise InputError(
                f"{where}.{name}: given prior {prior.low:g} to {prior.high:g}, physical limits "
                f"{least:g} to {most:g}; the prior range must be within the physical limits"
            )
    for name, allowed in (("sensors", SENSORS), ("segments", SEGMENTS)):
        given = getattr(kind, name)
        if not (isinstance(given, tuple) and set(given) <= set(allowed)):
            raise InputError.value(f"{where}.{name}", repr(given), f"a tuple of {allowed}")


def _check_on_sample(kind: type[Effect], where: str) -> None:
    """Raises `InputError` if the method fails, is not finite, or changes the model at the null."""
    place = PLACES[next(place for place in PLACES if issubclass(kind, place))]
    where, priors = f"{where}.{place.method}", kind.priors() | kind.shapes()

    def response(values: Array, moving: Array) -> Response:
        found = place.response(kind(**{name: values[i] for i, name in enumerate(priors)}), moving)
        return jax.tree.map(lambda x: jnp.asarray(x, float), found)

    null = np.array([prior.null for prior in priors.values()])
    try:
        _check_shapes(jax.eval_shape(response, null, np.array(1.0)), where)
        _check_numbers(response, kind, where)
    except InputError:
        raise
    except Exception as error:  # the method's own code may raise anything
        text = (str(error).splitlines() or [""])[0]
        raise InputError(
            f"{where}: fails on a sample input: {type(error).__name__}: {text}; the method must "
            "return what the base class describes, computed with jax.numpy"
        ) from error


def _check_shapes(found: Response, where: str) -> None:
    for given, allowed in ((found.given, found.unchanged), (found.state, found.memory)):
        if _shapes(given) != _shapes(allowed):
            part = "returns" if given is found.given else "returns a memory of"
            raise InputError(f"{where}: {part} {_shapes(given)}; allowed {_shapes(allowed)}")


def _shapes(tree: Any) -> str:
    """Returns a text with the types and the shapes of the arrays in `tree`."""
    if isinstance(tree, (list, tuple)) and not hasattr(tree, "_fields"):
        return f"({', '.join(map(_shapes, tree))})"
    if hasattr(tree, "shape"):
        return f"array of shape {tuple(tree.shape)}"
    leaves = dict.fromkeys(map(_shapes, jax.tree.leaves(tree)))
    return f"{type(tree).__name__} of {' and '.join(leaves)}"


def _check_numbers(
    response: Callable[[Array, Array], Response], kind: type[Effect], where: str
) -> None:
    """Checks values and derivatives. `response` takes the parameters and a factor of the motion.

    The parameters are in the order of `kind.priors()`, followed by `kind.shapes()`.
    """
    priors, shapes = list(kind.priors().values()), list(kind.shapes().values())
    null = np.array([x.null for x in priors + shapes])
    start = np.array([x.null if x.start is None else x.start for x in priors + shapes])
    ends = [x.high if x.high != x.null else x.low for x in priors] + [x.null for x in shapes]
    halfway = 0.5 * (null + np.array(ends))

    # Only the chosen number gets a tangent. JAX would multiply another parameter's infinite
    # derivative by a tangent of zero, and the result would be NaN.
    @partial(jax.jit, static_argnums=2)
    def with_tangent(values, moving, i):
        def one(x):
            return response([*values[:i], x, *values[i + 1 :]], moving)

        return jax.jvp(one, (values[i],), (jnp.ones_like(values[i]),))

    @jax.jit
    def motion_tangent(values, moving):
        return jax.jvp(lambda x: response(values, x), (moving,), (jnp.ones_like(moving),))

    advice = "avoid a division by zero and a square root at zero"
    for moving, state in ((np.array(1.0), "in motion"), (np.array(0.0), "at rest")):
        found, along = motion_tangent(null, moving)
        _require_finite(found, f"{where}: the value at the null, for a robot {state},", advice)
        text = f"{where}: the derivative with respect to the motion, for a robot {state},"
        _require_finite(along, text, advice)
        sizes = [np.abs(x).max() for x in jax.tree.leaves(found.unchanged)]
        for i, (name, prior) in enumerate(kind.priors().items()):
            if prior.start is None:
                _, tangent = with_tangent(null, moving, i)
                text = f"{where}: the derivative with respect to {name} at the null {prior.null:g}"
                _require_finite(tangent, text, f"{advice}, or give {name} a start")
                changes = [np.abs(x).max() for x in jax.tree.leaves(tangent.given)]
                width = prior.high - prior.low
                sizes = [a + width * b for a, b in zip(sizes, changes, strict=True)]
                continue
            at_start, tangent = with_tangent(start, moving, i)
            text = f"with {name} at its start {prior.start:g}"
            _require_finite(at_start, f"{where}: the value {text}", advice)
            _require_finite(tangent, f"{where}: the derivative {text}", advice)
        for i, name in enumerate(kind.shapes(), start=len(priors)):
            text = f"{where}: the derivative with respect to the shape parameter {name}"
            # The loop multiplies the derivative at the null by zero, so this must be finite too.
            for values, at in (
                (null, "at the null"),
                (halfway, "in the middle of the prior range"),
            ):
                _, tangent = with_tangent(values, moving, i)
                _require_finite(tangent, f"{text} {at}", advice)
        _require_null(found, sizes, kind, where)


def _require_finite(response: Response, what: str, advice: str) -> None:
    if not all(np.isfinite(x).all() for x in jax.tree.leaves(response)):
        raise InputError(f"{what} is NaN or infinite; allowed are finite numbers; {advice}")


def _require_null(response: Response, sizes: list[Any], kind: type[Effect], where: str) -> None:
    """Raises `InputError` if the effect changes the model at the null by more than rounding."""
    given, unchanged = (jax.tree.leaves(x) for x in (response.given, response.unchanged))
    for x, y, size in zip(given, unchanged, sizes, strict=True):
        change = np.abs(x - y).max()
        if change > np.sqrt(np.finfo(x.dtype).eps) * size:
            at = ", ".join(f"{name} = {prior.null:g}" for name, prior in kind.priors().items())
            raise InputError(
                f"{where}: changes the model by up to {change:.3g} at the null ({at}); allowed is "
                "no change; correct the null or the equation"
            )
