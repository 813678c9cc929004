"""Details of the terms: functions at smaller scales, and in the rear chamber only.

The expected values are written out, so that they share no function with the terms.
"""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation.waveform import SquareWave
from slider_jax.effects import Chamber
from slider_jax.effects.dictionary.details import DETAILS, FINE_PARTS, REAR_PARTS
from slider_jax.effects.library import DICTIONARY, KNOWN_EFFECTS, LIBRARY
from tests.support.helpers import reading, slider_readings

FACTORS = {"a": 0.1, "b": 0.2, "c": 0.4}
Z = np.array([0.0, 1 / 32, 1 / 8, 0.5, 1.0])


def chambers(p, p_set):
    p, p_set = (jnp.asarray(x, float) for x in (p, p_set))
    rear = np.array([0.0, 1.0])
    return Chamber(p, p_set, jnp.asarray(0.08), rear, jnp.sign(p), jnp.zeros((0, 2)))


def even(z):
    """|z|, z^2 and |z|^3 with the factors `FACTORS`, constant beyond 1."""
    z = np.minimum(np.abs(z), 1.0)
    return 0.1 * z + 0.2 * z**2 + 0.4 * z**3


def test_details_are_in_no_model_unless_a_function_needs_them():
    assert not set(DETAILS) & (set(DICTIONARY) | set(LIBRARY))
    assert set(DETAILS) < set(KNOWN_EFFECTS)
    assert set(REAR_PARTS) < set(DICTIONARY)
    assert not any(name.startswith(("rear_", "front_")) for name in REAR_PARTS)


@pytest.mark.parametrize("name", FINE_PARTS)
def test_a_fine_part_has_the_functions_of_its_term_at_two_smaller_scales(name):
    fine, term = FINE_PARTS[name](), KNOWN_EFFECTS[name]()
    z = term.scale * jnp.linspace(-1.0, 1.0, 33)
    expected = [*term.basis(4.0 * z), *term.basis(16.0 * z)]
    np.testing.assert_allclose(np.stack(fine.basis(z)), np.stack(expected))
    assert fine.place() == term.place() and fine.sensors == term.sensors
    assert {p.null for p in fine.priors().values()} == {0.0}


def test_the_fine_part_of_a_valve_changes_its_opening_near_zero():
    """With a scale of 160 kPa, the scales are 40 and 10 kPa. p_set - p is 100 kPa."""
    term = FINE_PARTS["valve_opening"](**FACTORS, scale=160e3)
    last = FINE_PARTS["valve_opening"](d=0.1, e=0.2, f=0.4, scale=160e3)
    for p in 160e3 * Z:
        x, rate = chambers([p, -p], [p + 100e3, -p]), jnp.zeros(2)
        np.testing.assert_allclose(term.rate(rate, x), [12.5 * even(p / 40e3) * 100e3, 0.0])
        np.testing.assert_allclose(last.rate(rate, x), [12.5 * even(p / 10e3) * 100e3, 0.0])


def test_the_fine_part_of_a_moment_acts_in_the_part_of_its_term():
    term = FINE_PARTS["moment_of_tail_by_side"](**FACTORS, scale=2.0)
    tail = np.array([0.0, 0.0, 1.0, 1.0, 1.0])
    x = SimpleNamespace(kappa=jnp.asarray(2.0 * Z), EI=0.04, in_tail=jnp.asarray(tail))
    found, _ = term.moment(x, jnp.zeros(5), 1e-3)
    np.testing.assert_allclose(found, 0.04 * 2.0 * even(4.0 * Z) * tail)


def test_the_stiffness_of_recent_bending_has_a_derivative_at_rest():
    term = KNOWN_EFFECTS["stiffness_of_recent_bending"](a=0.3, scale=2.0)
    x = SimpleNamespace(kappa=jnp.zeros(2), EI=0.04, in_tail=jnp.zeros(2))
    found, memory = term.moment(x, jnp.zeros(2), 1e-3)
    assert not found.any() and not memory.any()


def test_rear_parts_change_only_the_rear_chamber():
    x, rate = chambers([80e3, -80e3], [160e3, -160e3]), jnp.zeros(2)
    found = REAR_PARTS["valve_opening"](**FACTORS, scale=160e3).rate(rate, x)
    np.testing.assert_allclose(found, [0.0, -12.5 * even(0.5) * 80e3])

    wave = SquareWave(jnp.asarray(1.0), jnp.asarray(100e3))
    term = REAR_PARTS["set_pressure_powers_by_side"](**FACTORS, scale=200e3)
    first = term.command(wave, 0).segment(jnp.asarray(0.1), jnp.asarray(0.2))
    np.testing.assert_array_equal(first.a0, 100e3)
    segment = term.command(wave, 1).segment(jnp.asarray(0.1), jnp.asarray(0.2))
    np.testing.assert_allclose(segment.a0, 100e3 + 20e3 * even(0.5))

    term = REAR_PARTS["acting_pressure_of_other"](a=0.5, scale=160e3)
    acting, _ = term.act(jnp.array([80e3, 40e3]), jnp.zeros((2, 2)), 1e-3)
    np.testing.assert_allclose(acting, [80e3, 40e3 + 20e3 * 0.5 * 0.5])


def test_the_rear_pressure_sensor_alone_reads_the_other_pressure():
    t, p = jnp.arange(5.0), jnp.asarray(100e3 * Z)
    true = slider_readings(t, p, -p, *(3 * [jnp.zeros(5)]))
    read = DICTIONARY["pressure_reading_of_other_of_rear"](a=0.5, scale=1.0).read(true)
    np.testing.assert_allclose(read.pressures[1], -p + 50e3 * Z)
    for name in ("p_front", "thrust", "recoil", "tip"):
        np.testing.assert_array_equal(reading(read, name), reading(true, name))
