"""Every effect of the library: what it declares, its null, and its tangents there.

One compiled program holds all effects at once, their parameters as one vector; a tangent is a JVP
along one of its entries, and a finite difference another call of the same program.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation import FirstOrderLag, SquareWave
from slider_jax.beam.parameters import uniform_robot
from slider_jax.channels import recorded
from slider_jax.dynamics.model import Drive, Model
from slider_jax.dynamics.pressures import start_chambers
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.effects import NormalDrag, ReactiveForce
from slider_jax.effects.library import LIBRARY
from slider_jax.observables import recoil, thrust, tip
from slider_jax.supports import Clamped
from tests.support.helpers import SMALL, arrays, slider_readings

SENSORS = ("pressure", "pressure", "thrust", "recoil", "tip")
"""Sensors of the rows of `readings`."""
PARAMETERS = {name: kind.priors() | kind.shapes() for name, kind in LIBRARY.items()}
ENTRIES = [(name, parameter) for name, mine in PARAMETERS.items() for parameter in mine]
"""Parameters and shape parameters of all effects. The `null` of a shape is its default."""
PRIORS = [PARAMETERS[name][parameter] for name, parameter in ENTRIES]
NULL = np.array([prior.null for prior in PRIORS])
TIMES = TimeGrid(1.0 / 240.0, 30)
"""Half a stride: each chamber has an edge of the drive."""


def readings(effects):
    """(5, steps + 1): the sensors of a towed robot from rest; drive edges between steps."""
    model = Model(
        uniform_robot(),
        (NormalDrag(3.0), ReactiveForce(1.0), *effects),
        FirstOrderLag(0.03),
        Drive((SquareWave(4.0, 250e3, 0.031), SquareWave(4.0, 220e3, 0.177))),
        Clamped(tow_speed=0.1),
    )
    model = arrays(model)

    def save(x):
        return jnp.stack([*x.chambers.p, thrust(x), recoil(x), tip(x)])

    run = rollout(model, TIMES, save, SMALL, checkpoint=False)
    first = jnp.concatenate([start_chambers(model).p, jnp.zeros(3)])
    t = jnp.concatenate([jnp.zeros(1), TIMES.times])
    read = recorded(model.effects, slider_readings(t, *jnp.concatenate([first[None], run.saved]).T))
    return jnp.where(run.ok, jnp.stack([*read.pressures, *read[2:]]), jnp.nan)


def extended(theta):
    """Readings with every effect of the library, parameters as in `ENTRIES`."""
    values = dict(zip(ENTRIES, theta, strict=True))
    return readings(
        tuple(
            kind(**{parameter: values[name, parameter] for parameter in PARAMETERS[name]})
            for name, kind in LIBRARY.items()
        )
    )


@jax.jit
def _moved(theta, direction):
    return jax.jvp(extended, (theta,), (direction,))


@cache
def value_and_tangent(entry, steps=0.0):
    """Readings (5, n) with one entry `steps` prior ranges off its null, and their tangent."""
    along = np.zeros_like(NULL)
    along[entry] = PRIORS[entry].high - PRIORS[entry].low
    return tuple(np.asarray(x) for x in _moved(jnp.asarray(NULL + steps * along), along))


@cache
def bare():
    return np.asarray(jax.jit(lambda: readings(()))())


def largest(x):
    """Largest size in each channel: (..., 5, n) to (..., 5)."""
    return np.abs(x).max(axis=-1)


def differs(found):
    return largest(found - bare()) > 1e-12 * largest(bare())


def changing_at_null(names):
    """Returns the effects that change a reading at their null, found by bisection."""
    found = np.asarray(jax.jit(lambda: readings(tuple(LIBRARY[name]() for name in names)))())
    if not differs(found).any():
        return []
    half = len(names) // 2
    return changing_at_null(names[:half]) + changing_at_null(names[half:]) if half else names


@pytest.mark.slow
def test_effects_at_their_nulls_change_no_reading():
    if differs(value_and_tangent(0)[0]).any():
        pytest.fail(f"changes a reading at the null: {changing_at_null(list(LIBRARY))}")


WITH_START = {
    name for (name, _), prior in zip(ENTRIES, PRIORS, strict=True) if prior.start is not None
}
"""Effects with a start, because their tangent at the null does not predict their action."""
FREE_HEAD_ONLY = {"head_added_mass"}
SHAPES = [i for i, (name, x) in enumerate(ENTRIES) if x in LIBRARY[name].shapes()]
AT_NULL = [
    i
    for i, (name, _) in enumerate(ENTRIES)
    if name not in WITH_START | FREE_HEAD_ONLY and i not in SHAPES
]


@pytest.fixture(params=AT_NULL, ids=[".".join(ENTRIES[i]) for i in AT_NULL])
def entry(request):
    return request.param


@cache
def at_start(name, entry, steps=0.0):
    """Readings (5, n) with an effect at its start, one of its entries moved by prior ranges."""
    theta, along = NULL.copy(), np.zeros_like(NULL)
    for i, (other, _) in enumerate(ENTRIES):
        if other == name and PRIORS[i].start is not None:
            theta[i] = PRIORS[i].start
    along[entry] = PRIORS[entry].high - PRIORS[entry].low
    return tuple(np.asarray(x) for x in _moved(jnp.asarray(theta + steps * along), along))


@pytest.mark.parametrize("name", sorted(WITH_START))
def test_effect_at_its_start_changes_only_the_declared_sensors(name):
    mine = [i for i, (other, _) in enumerate(ENTRIES) if other == name and i not in SHAPES]
    change = at_start(name, mine[0])[0] - bare()
    share = largest(change) / largest(bare())
    declared = np.array([x in LIBRARY[name].sensors for x in SENSORS])
    assert np.isfinite(change).all()
    assert share[declared].max() > 1e-4
    assert share[~declared].max(initial=0.0) <= 1e-9 * share.max()


@pytest.mark.parametrize("name", sorted(WITH_START))
def test_tangents_at_the_start_are_the_finite_differences(name):
    """Less strict than at a null, because the corner of a limit is between two steps."""
    for i in (i for i, (other, _) in enumerate(ENTRIES) if other == name and i not in SHAPES):
        step = 1e-4
        tangent = at_start(name, i)[1]
        found = (at_start(name, i, step)[0] - at_start(name, i, -step)[0]) / (2.0 * step)
        assert np.isfinite(tangent).all(), ENTRIES[i]
        off = largest(found - tangent)
        allowed = 2e-2 * largest(tangent) + 1e-5 * largest(bare())
        assert (off <= allowed).all(), (ENTRIES[i], off, allowed)


@pytest.mark.slow
def test_tangent_at_the_null_changes_only_the_declared_sensors(entry):
    """Per prior range, the tangent is finite and exceeds 1e-6 of a declared sensor's reading."""
    tangent = value_and_tangent(entry)[1]
    assert np.isfinite(tangent).all()
    share = largest(tangent) / largest(bare())
    declared = np.array([x in LIBRARY[ENTRIES[entry][0]].sensors for x in SENSORS])
    assert share[declared].max() > 1e-6
    assert share[~declared].max(initial=0.0) <= 1e-9 * share.max()


@pytest.mark.parametrize("shape", SHAPES, ids=[".".join(ENTRIES[i]) for i in SHAPES])
@pytest.mark.slow
def test_a_shape_parameter_acts_only_while_its_effect_does(shape):
    """At half of an effect's range, its tangent is the difference; at the null, it vanishes."""
    assert not value_and_tangent(shape)[1].any()
    name, theta, along = ENTRIES[shape][0], NULL.copy(), np.zeros_like(NULL)
    for i, (other, parameter) in enumerate(ENTRIES):
        if other == name and parameter in LIBRARY[name].priors():
            theta[i] = 0.5 * (PRIORS[i].null + PRIORS[i].high)
    along[shape] = PRIORS[shape].high - PRIORS[shape].low

    def at(step):
        value, tangent = _moved(jnp.asarray(theta + step * along), along)
        assert np.isfinite(value).all()
        return np.asarray(value), np.asarray(tangent)

    tangent, step = at(0.0)[1], 1e-4
    found = (at(step)[0] - at(-step)[0]) / (2.0 * step)
    assert np.isfinite(tangent).all()
    assert (largest(tangent) / largest(bare())).max() > 1e-4
    off, allowed = largest(found - tangent), 1e-2 * largest(tangent) + 1e-6 * largest(bare())
    assert (off <= allowed).all(), (off, allowed)


def difference(entry, step):
    """Second-order difference: central, or one-sided if the null is an end of the range."""

    def value(steps):
        return value_and_tangent(entry, steps * step)[0]

    prior = PRIORS[entry]
    if prior.low < prior.null < prior.high:
        return (value(1) - value(-1)) / (2.0 * step)
    s = 1 if prior.null < prior.high else -1
    return s * (4.0 * value(s) - value(2 * s) - 3.0 * value(0)) / (2.0 * step)


def test_tangent_at_the_null_is_the_finite_difference(entry):
    """The shorter step is for effects that are linear only in a small part of their range."""
    tangent = value_and_tangent(entry)[1]
    allowed = 1e-3 * largest(tangent) + 1e-9 * largest(bare())
    off = largest(difference(entry, 2e-4) - tangent)
    if (off > allowed).any():
        off = largest(difference(entry, 2e-6) - tangent)
    assert (off <= allowed).all(), f"off by {off}, allowed {allowed}"


@pytest.mark.parametrize("name", LIBRARY)
def test_declares_what_reports_and_searches_need(name):
    kind = LIBRARY[name]
    assert kind.title
    assert "Source:" in (kind.__doc__ or "")
    assert kind.sensors and set(kind.sensors) <= set(SENSORS)
    assert kind.priors()
    for parameter, prior in kind.priors().items():
        assert prior.low <= prior.null <= prior.high, parameter
        assert prior.low < prior.high, parameter
        assert prior.unit and prior.why, parameter
        assert getattr(kind(), parameter) == prior.null
    assert len(kind.shapes()) <= 2
    for parameter, shape in kind.shapes().items():
        assert shape.low < shape.null < shape.high, parameter
        assert shape.unit and shape.why, parameter
        assert getattr(kind(), parameter) == shape.null


def test_only_effects_of_the_body_name_the_segments_that_they_change():
    for name, kind in LIBRARY.items():
        inside = kind.__module__.split(".")[-2] == "body" and kind.place() != "Mounting"
        assert set(kind.segments) <= {"body", "tail"}, name
        assert bool(kind.segments) == inside, name
