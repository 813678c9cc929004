"""The terms of the dictionary: null, tangents, basis functions, and use in a model file."""

import importlib
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from calibration.model.extended import candidate_effects
from slider_jax.effects import Chamber, Readings
from slider_jax.effects.check import checked_effects
from slider_jax.effects.functions import Powers, even_powers, mixed_powers, odd_corners, odd_powers
from slider_jax.effects.library import DICTIONARY, LIBRARY
from slider_jax.experiment.load import assemble
from slider_jax.simulation.effect_signature import built_in_experiment
from slider_jax.simulation.trial import simulate_trial
from tests.support.helpers import slider_readings

FILES = sorted({kind.__module__.split(".")[-1] for kind in DICTIONARY.values()} - {"details"})


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_terms_vanish_at_their_nulls_and_have_finite_tangents(name):
    """`checked_effects` refuses a term that does not."""
    module = importlib.import_module(f"slider_jax.effects.dictionary.{name}")
    kinds = checked_effects(module, name, {})
    assert {kind.name() for kind in kinds} <= set(DICTIONARY)
    assert all(prior.null == 0.0 for kind in kinds for prior in kind.priors().values())


def test_the_dictionary_is_no_part_of_the_library():
    assert len(FILES) == 7 and len(DICTIONARY) == 159
    assert not set(DICTIONARY) & (set(LIBRARY) | set(candidate_effects()))


@pytest.mark.parametrize("name", DICTIONARY)
def test_a_term_has_a_basis_function_for_every_parameter_or_for_every_part(name):
    effect = DICTIONARY[name]()
    basis = np.asarray(effect.basis(getattr(effect, "scale", 1.0) * jnp.linspace(-1.0, 1.0, 5)))
    assert np.isfinite(basis).all() and np.abs(basis).max() > 0.0
    if set(effect.priors()) == {"body", "tail"}:
        assert basis.shape == (5,)
        assert effect.basis(jnp.zeros(())) == 0.0
    else:
        assert basis.shape == (len(effect.priors()), 5)


Z = np.array([-1.0, -0.5, 0.0, 0.25, 1.0])
"""States, in units of the largest visited state."""


def section(**states):
    """A section of five cells in motion; cells 3 and 4 are in the tail."""
    zero, tail = jnp.zeros(5), jnp.array([0.0, 0.0, 0.0, 1.0, 1.0])
    rest = dict.fromkeys(("u_n", "u_tau", "kappa", "kappa_t", "pressure", "s"), zero)
    return SimpleNamespace(**rest | {"EI": 0.04, "in_tail": tail, "t": jnp.zeros(())} | states)


def moment(name, x, **values):
    """Moment of a term without a state, divided by EI."""
    found, memory = DICTIONARY[name](**values).moment(x, jnp.full(5, 7.0), 1e-3)
    assert (memory == 7.0).all()
    return np.asarray(found) / x.EI


def test_even_powers_are_the_absolute_value_the_square_and_the_absolute_cube():
    """The expected values are literals, because another term could share an error."""
    expected = [[1.0, 0.5, 0.0, 0.25, 1.0], [1.0, 0.25, 0.0, 0.0625, 1.0]]
    expected.append([1.0, 0.125, 0.0, 0.015625, 1.0])
    np.testing.assert_allclose(even_powers(jnp.asarray(Z), 2.0), 2.0 * np.array(expected))


def test_odd_corners_are_linear_beyond_a_quarter_a_half_and_three_quarters():
    z = jnp.array([-2.0, -1.0, -0.6, -0.2, 0.2, 0.6, 1.0, 2.0])
    quarter = [-0.75, -0.75, -0.35, 0.0, 0.0, 0.35, 0.75, 0.75]
    half = [-0.5, -0.5, -0.1, 0.0, 0.0, 0.1, 0.5, 0.5]
    most = [-0.25, -0.25, 0.0, 0.0, 0.0, 0.0, 0.25, 0.25]
    expected = 3.0 * np.array([quarter, half, most])
    np.testing.assert_allclose(odd_corners(z, 3.0), expected, atol=1e-15)


def test_mixed_powers_are_the_state_its_absolute_value_and_its_square():
    expected = [Z, np.abs(Z), Z**2]
    np.testing.assert_allclose(mixed_powers(jnp.asarray(Z), 3.0), 3.0 * np.array(expected))
    np.testing.assert_allclose(mixed_powers(jnp.array(-4.0)), [-1.0, 1.0, 1.0])


def test_powers_are_constant_beyond_the_largest_visited_state():
    z = jnp.array([-3.0, -1.0, -0.5, 0.5, 1.0, 3.0])
    odd, even = np.asarray(odd_powers(z)), np.asarray(even_powers(z))
    np.testing.assert_allclose(odd[2], [-1.0, -1.0, -0.125, 0.125, 1.0, 1.0])
    np.testing.assert_allclose(odd, -odd[:, ::-1])
    np.testing.assert_allclose(even, np.abs(odd))
    scaled = [
        kind()
        for kind in DICTIONARY.values()
        if issubclass(kind, Powers) and "scale" in kind.shapes()
    ]
    assert len(scaled) == 115
    for term in scaled:
        ends = np.asarray(term.basis(term.scale * jnp.array([-3.0, -1.0, 1.0, 3.0])))
        np.testing.assert_allclose(ends[:, [0, 3]], ends[:, [1, 2]])


def test_a_drift_of_the_gain_is_proportional_to_the_reading():
    t = jnp.array([0.0, 1.0, 2.0])
    true = slider_readings(t, 1e5 * (1.0 + t), -2e5 * t, t, t, t)
    read = DICTIONARY["pressure_reading_gain_drift"](a=0.1, b=0.02).read(true)
    gain = 1.0 + 0.1 * t + 0.02 * (1.0 - np.exp(-2.0 * t))
    np.testing.assert_allclose(read.pressures, gain * true.pressures)
    np.testing.assert_array_equal(read.tip, true.tip)


@pytest.mark.parametrize(("name", "axis"), [("water_sine_along", 0), ("water_sine_across", 1)])
def test_the_water_oscillates_along_one_axis(name, axis):
    t = jnp.linspace(0.0, 1.0, 30)
    velocity = DICTIONARY[name](a=0.1, b=-0.05, frequency=2.7).velocity(t)
    angle = 2.0 * np.pi * 2.7 * t
    expected = 0.1 * jnp.sin(angle) - 0.05 * jnp.cos(angle)
    np.testing.assert_allclose(velocity[axis], expected, atol=1e-12)
    np.testing.assert_array_equal(velocity[1 - axis], 0.0)


@pytest.mark.parametrize(("name", "cells"), [("robot", slice(5)), ("tail", slice(3, 5))])
def test_the_axial_force_is_an_even_function_of_the_lateral_velocity(name, cells):
    """The smallest power is linear in |u_n|; the parameters are in units of 10 N/m."""
    term = DICTIONARY[f"axial_force_on_{name}"](a=0.2, b=-0.3, c=0.5, scale=0.8)
    F_tau, F_n = term.force(section(u_n=jnp.asarray(0.8 * Z)))
    expected = np.zeros(5)
    expected[cells] = (2.0 * np.abs(Z) - 3.0 * Z**2 + 5.0 * np.abs(Z) ** 3)[cells]
    np.testing.assert_allclose(F_tau, expected)
    np.testing.assert_array_equal(F_n, 0.0)


def test_axial_friction_depends_on_the_axial_velocity_of_the_whole_robot():
    x = section(u_tau=jnp.asarray(0.4 * Z), u_n=jnp.full(5, -0.25))
    F_tau, F_n = DICTIONARY["axial_friction"](a=0.2, b=-0.3, c=0.5, scale=0.4).force(x)
    np.testing.assert_allclose(F_tau, 2.0 * Z - 3.0 * Z * np.abs(Z) + 5.0 * Z**3)
    np.testing.assert_array_equal(F_n, 0.0)
    F_tau, F_n = DICTIONARY["axial_friction_of_crossflow"](body=3.0, tail=-2.0).force(x)
    np.testing.assert_allclose(F_tau, np.array([3.0, 3.0, 3.0, -2.0, -2.0]) * 0.4 * Z)
    np.testing.assert_array_equal(F_n, 0.0)


def test_the_moment_of_the_root_quadruples_if_the_rate_is_sixteen_times_as_large():
    rates = jnp.array([-960.0, -60.0, 0.0, 60.0, 960.0])
    found = moment("moment_of_rate_root", section(kappa_t=rates), body=2.0, tail=-1.0)
    np.testing.assert_allclose(found, [-8.0, -2.0, 0.0, -1.0, -4.0], rtol=2e-4)


def test_the_damping_depends_on_the_pressure_of_the_chamber():
    """The damping time is 0.05 s times the sum of q, |q| and q^2; the tail has no chamber."""
    x = section(pressure=jnp.asarray(150e3 * Z), kappa_t=jnp.full(5, -20.0))
    found = moment("damping_of_pressure", x, a=0.1, b=0.2, c=0.4, scale=150e3)
    expected = -20.0 * 0.05 * (0.1 * Z + 0.2 * np.abs(Z) + 0.4 * Z**2)
    np.testing.assert_allclose(found, np.where(x.in_tail, 0.0, expected))
    assert not moment("damping_of_pressure", section(pressure=x.pressure), b=1.0).any()


@pytest.mark.parametrize(("t", "q"), [(2.0, 0.5), (9.0, 1.0)])
def test_local_drifts_are_steady_or_settle_up_to_their_scale(t, q):
    x = section(t=jnp.asarray(t), kappa=3.0 * Z, kappa_t=60.0 * Z, u_n=0.5 * Z)
    slow, fast = 1.0 - np.exp(-q / 0.3), 1.0 - np.exp(-q / 0.1)
    drift, body = 0.1 * q - 0.02 * slow + 0.03 * fast, 1.0 - np.asarray(x.in_tail)
    for name in ("stiffness_drift", "damping_drift"):
        found = moment(name, x, a=0.1, b=-0.02, c=0.03, scale=4.0)
        np.testing.assert_allclose(found, 3.0 * drift * body * Z)
    F_tau, F_n = DICTIONARY["drag_drift"](a=0.1, b=-0.02, c=0.03, scale=4.0).force(x)
    np.testing.assert_allclose(F_n, 10.0 * drift * Z * np.abs(Z))
    np.testing.assert_array_equal(F_tau, 0.0)


OTHERS = [(s, o) for s in ("thrust", "recoil") for o in ("pressure", "tip")]


@pytest.mark.parametrize(("sensor", "other"), OTHERS)
def test_the_error_of_a_force_sensor_depends_on_another_channel(sensor, other):
    """A pressure is in units of 100 kPa, a tip position in units of 20 mm."""
    y = np.linspace(0.3, 0.7, 5)
    true = slider_readings(jnp.arange(5.0), 1e5 * Z, -2e5 * Z, 0.4 * y, y, 0.02 * Z)
    term = DICTIONARY[f"{sensor}_reading_of_{other}"](a=0.1, b=0.2, c=0.4, scale=2.0)
    read = term.read(true)
    parts = [0.5 * Z, -Z] if other == "pressure" else [0.5 * Z]
    error = sum(0.1 * q + 0.2 * np.abs(q) + 0.4 * q**2 for q in parts)
    scale = {"thrust": 0.2, "recoil": 1.0}[sensor]
    np.testing.assert_allclose(getattr(read, sensor), getattr(true, sensor) + scale * error)
    for name in set(true._fields) - {sensor}:
        np.testing.assert_array_equal(getattr(read, name), getattr(true, name))
    last = term.read_sample(true, Readings(*(x[..., :-1] for x in read)))
    for found, expected in zip(last, read, strict=True):
        np.testing.assert_allclose(found, expected[..., -1])


def chambers(p, p_set):
    """The state of both chambers; k is 0.08 s."""
    p, p_set = (jnp.asarray(x, float) for x in (p, p_set))
    zeros = jnp.zeros((0, 2))
    return Chamber(p, p_set, jnp.asarray(0.08), np.array([0.0, 1.0]), jnp.sign(p), zeros)


def test_the_flow_between_the_chambers_is_opposite_in_both():
    """The flow at the scale is 3 MPa/s per unit of a parameter; the root of 1/4 is 1/2.

    The smooth corner of the root changes it by 0.16 %.
    """
    term = DICTIONARY["flow_between_chambers"](a=-0.2, b=0.1, c=0.3, scale=200e3)
    found = term.rate(jnp.array([1e5, 2e5]), chambers([60e3, 10e3], [0.0, 0.0]))
    flow = 3e6 * (-0.2 * 0.5 + 0.1 * 0.25 + 0.3 * 0.0625)
    np.testing.assert_allclose(found, [1e5 + flow, 2e5 - flow], atol=1e3)


def test_a_shared_supply_changes_the_flow_only_while_both_chambers_fill():
    term = DICTIONARY["filling_opening_of_other"](a=-0.5, scale=200e3)
    rate, front, rear = jnp.array([5e6, -5e6]), [100e3, -50e3], [200e3, -250e3]
    both = term.rate(rate, chambers(front, rear))
    # The front misses 100 kPa, which is half of the scale, and the rear misses 200 kPa.
    np.testing.assert_allclose(both - rate, -0.5 * 12.5 * np.array([1e5 * 1.0, -2e5 * 0.5]))
    venting = term.rate(rate, chambers(front, [200e3, 0.0]))
    np.testing.assert_array_equal(venting, rate)


def test_friction_that_depends_on_the_pressure_has_the_state_of_dry_friction():
    x = section(pressure=jnp.asarray(150e3 * Z), kappa_t=jnp.full(5, 40.0))
    term = DICTIONARY["friction_of_pressure"](a=0.1, b=0.2, c=0.4, scale=150e3)
    found, q = term.moment(x, jnp.full(5, 0.5), 1e-3)
    np.testing.assert_allclose(q, (0.5 + 0.04 / 0.3) / (1.0 + 0.04 / 0.3), rtol=1e-3)
    size = np.abs(Z)
    expected = q * 0.05 * (0.1 * size + 0.2 * size**2 + 0.4 * size**3)
    np.testing.assert_allclose(found, np.where(x.in_tail, 0.0, expected))


def test_the_stiffness_of_recent_bending_follows_the_mean_square_of_the_curvature():
    """After ten time constants, the mean square is the square of the curvature."""
    x, memory = section(kappa=jnp.asarray(2.0 * Z)), jnp.zeros(5)
    term = DICTIONARY["stiffness_of_recent_bending"](a=-0.3, b=0.2, c=0.3, scale=2.0)
    first, memory = term.moment(x, memory, 1e-3)
    assert np.abs(first).max() < 1e-3
    for _ in range(3000):
        found, memory = term.moment(x, memory, 1e-3)
    np.testing.assert_allclose(memory, 4.0 * Z**2, rtol=1e-4)
    square = Z**2
    stiffness = 0.04 * (-0.3 * square + 0.2 * square**2 + 0.3 * square**3)
    np.testing.assert_allclose(found, np.where(x.in_tail, 0.0, stiffness * 2.0 * Z), rtol=1e-3)


def test_the_moment_of_a_chamber_drifts_in_proportion_to_its_pressure():
    x = section(pressure=jnp.full(5, 100e3), t=jnp.asarray(1.0))
    found = moment("moment_drift", x, a=0.4, b=-0.2, scale=2.0) * x.EI
    drift = 0.4 * 0.5 - 0.2 * (1.0 - np.exp(-0.5 / 0.3))
    np.testing.assert_allclose(found[:3], 0.05 * 0.5 * drift)
    np.testing.assert_array_equal(found[3:], 0.0)


def test_the_memory_of_a_sensor_is_the_step_response_of_its_curve():
    t = 1e-3 * jnp.arange(600.0)
    step = jnp.where(t > 0.0, 0.4, 0.0)
    true = slider_readings(t, *(5 * [step]))
    term = DICTIONARY["thrust_reading_memory"](a=0.2, b=-0.3, c=0.5)
    change = term.read(true).thrust - step
    curve = sum(f * x for f, x in zip((0.2, -0.3, 0.5), term.basis(t), strict=True))
    np.testing.assert_allclose(change, 0.4 * curve, atol=2e-3)  # the step takes a millisecond
    np.testing.assert_allclose(term.basis(jnp.array(0.3))[1], 1.0 - np.exp(-1.0))


def test_the_hysteresis_of_a_sensor_depends_on_the_direction():
    """Each state of friction is 1 while the reading rises, and -1 while it falls."""
    up = jnp.linspace(0.0, 8.0, 400)
    y = jnp.concatenate([up, up[::-1]])
    true = slider_readings(1e-3 * jnp.arange(800.0), *(5 * [y]))
    term = DICTIONARY["recoil_reading_hysteresis"](a=0.1, b=0.02, c=0.004)
    change = np.asarray(term.read(true).recoil - y)
    np.testing.assert_allclose(change[[0, 399, 799]], [0.0, 0.124, -0.124], atol=1e-3)
    curve = 0.1 * term.basis(up)[0] + 0.02 * term.basis(up)[1] + 0.004 * term.basis(up)[2]
    np.testing.assert_allclose(change[:400], curve, atol=1e-9)


def test_the_delay_of_the_camera_depends_on_the_tip_position():
    t = 1e-3 * jnp.arange(1000.0)
    tip = 0.01 * jnp.sin(2.0 * np.pi * t)
    read = (
        DICTIONARY["tip_reading_delay"](a=0.3, scale=1.0).read(slider_readings(t, *(5 * [tip]))).tip
    )
    late = 0.01 * np.sin(2.0 * np.pi * (t - 0.02 * 0.3 * tip / 0.02))
    np.testing.assert_allclose(read[10:-10], late[10:-10], atol=1e-8)


def test_an_error_of_a_pressure_sensor_depends_on_the_other_pressure():
    true = slider_readings(jnp.arange(5.0), 1e5 * Z, jnp.full(5, 1e5), Z, Z, Z)
    read = DICTIONARY["pressure_reading_of_other"](a=0.1, b=0.2, c=0.4, scale=2.0).read(true)
    np.testing.assert_allclose(read.pressures[0] - true.pressures[0], 1e5 * (0.05 + 0.1 + 0.1))
    q = 0.5 * Z
    np.testing.assert_allclose(
        read.pressures[1] - true.pressures[1], 1e5 * (0.1 * q + 0.2 * np.abs(q) + 0.4 * q**2)
    )


SINES = [k for k, kind in DICTIONARY.items() if "frequency" in kind.shapes()]


@pytest.mark.parametrize("name", SINES)
def test_a_sine_repeats_with_the_period_of_its_frequency(name):
    """The curve of a report shows the sine over the phase, the fraction of f t."""
    term, t = DICTIONARY[name](a=0.3, b=-0.4, frequency=2.5), jnp.linspace(0.0, 1.6, 17)
    np.testing.assert_allclose(term.at(t + 0.4), term.at(t), atol=1e-12)
    np.testing.assert_allclose(term.at(t + 0.2), -term.at(t), atol=1e-12)
    np.testing.assert_allclose(term.at(jnp.array([0.0, 0.1])), [-0.4, 0.3], atol=1e-12)
    phase = term.state(SimpleNamespace(t=t))
    assert 0.0 <= float(phase.min()) and float(phase.max()) < 1.0
    sine, cosine = term.basis(phase)
    np.testing.assert_allclose(0.3 * sine - 0.4 * cosine, term.at(t), atol=1e-12)


def test_damping_terms_have_the_stated_signs():
    """Columns: both signs of the curvature, and both signs of its rate."""
    kappa, rate = jnp.array([2.0, 2.0, -2.0, -2.0]), jnp.array([30.0, -30.0, 30.0, -30.0])
    x = SimpleNamespace(kappa=kappa, kappa_t=rate, EI=1.0, in_tail=jnp.zeros(4))

    def signs(name, **factors):
        moment, _ = DICTIONARY[name](**factors).moment(x, jnp.zeros(4), 1e-3)
        return np.sign(moment).tolist()

    assert signs("moment_of_rate_by_side", body=1.0) == [1, 1, 1, 1]
    assert signs("moment_of_straightening", body=1.0) == [1, 1, -1, -1]
    assert signs("damping_of_body", a=1.0) == [1, -1, -1, 1]
    assert signs("damping_of_body", c=1.0) == [1, -1, 1, -1]
    assert signs("damping_of_tail", a=1.0) == [0, 0, 0, 0]
    assert signs("damping_of_bent_body", b=1.0) == [1, -1, 1, -1]
    assert signs("damping_of_bent_tail", b=1.0) == [0, 0, 0, 0]


@pytest.mark.slow
def test_the_simulation_of_a_model_file_contains_its_terms(tmp_path):
    content = built_in_experiment().model_dump()
    content["numerics"] |= {"nodes": 11, "step": 5e-3}
    content["trials"] = [content["trials"][0] | {"duration": 0.1}]

    def thrust(text):
        (tmp_path / "model.toml").write_text(text)
        experiment = assemble(content, "test", tmp_path, tmp_path / "model.toml")
        return simulate_trial(experiment, declared_drive=True).series["thrust"]

    table = '[[effects]]\nname = "normal_force_on_tail"\nb = {}\nc = {}\n'
    null, changed = thrust(table.format(0.0, 0.0)), thrust(table.format(-5.0, -5.0))
    assert np.isfinite(changed).all() and np.abs(changed - null).max() > 1e-3 * np.abs(null).max()
