"""Terms of the dictionary that multiply a law by a function of another state, and of the command.

The expected values are written out, so that they share no function with the terms.
"""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation.waveform import SineWave, SquareWave
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.effects import Chamber
from slider_jax.effects.library import DICTIONARY
from tests.support.helpers import reading, slider_readings

Z = np.array([-1.0, -0.5, 0.0, 0.25, 1.0])
"""States, in units of the scale."""
MIXED = 0.1 * Z + 0.2 * np.abs(Z) + 0.4 * Z**2
ODD = 0.1 * Z + 0.2 * Z * np.abs(Z) + 0.4 * Z**3
FACTORS = {"a": 0.1, "b": 0.2, "c": 0.4}
BODY = np.array([1.0, 1.0, 1.0, 0.0, 0.0])


def section(**states):
    """A section of five cells; cells 3 and 4 are in the tail. EI is 0.04 N m^2."""
    names = ("u_n", "u_n_t", "u_tau", "omega", "kappa", "kappa_t", "pressure", "phi", "s")
    rest = dict.fromkeys(names, jnp.zeros(5)) | {"EI": 0.04, "in_tail": jnp.asarray(1.0 - BODY)}
    return SimpleNamespace(**rest | {k: jnp.asarray(x) for k, x in states.items()})


def moment(name, x, scale):
    found, _ = DICTIONARY[name](**FACTORS, scale=scale).moment(x, jnp.zeros(5), 1e-3)
    return np.asarray(found)


def force(name, x, scale):
    F_tau, F_n = DICTIONARY[name](**FACTORS, scale=scale).force(x)
    np.testing.assert_array_equal(F_tau, 0.0)
    return np.asarray(F_n)


def chambers(p, p_set, states=None):
    p, p_set = (jnp.asarray(x, float) for x in (p, p_set))
    states = jnp.zeros((0, 2)) if states is None else jnp.asarray(states, float)
    return Chamber(p, p_set, jnp.asarray(0.08), np.array([0.0, 1.0]), jnp.sign(p), states)


def test_the_stiffness_depends_on_the_pressure():
    x = section(pressure=150e3 * Z, kappa=np.full(5, 2.0))
    found = moment("stiffness_of_pressure", x, 150e3)
    np.testing.assert_allclose(found, 0.04 * MIXED * 2.0 * BODY)


def test_the_moment_of_a_chamber_depends_on_the_curvature():
    """The moment of a chamber is 0.05 N m at 200 kPa."""
    x = section(pressure=np.full(5, 100e3), kappa=2.0 * Z)
    found = moment("moment_of_pressure_and_curvature", x, 2.0)
    np.testing.assert_allclose(found, 0.025 * MIXED * BODY)


@pytest.mark.parametrize(
    ("name", "states", "law", "cells"),
    [
        ("stiffness_along_robot", {"kappa": 2.0}, 0.04 * 2.0, np.ones(5)),
        ("damping_along_robot", {"kappa_t": 20.0}, 0.04 * 0.05 * 20.0, np.ones(5)),
        ("moment_along_body", {"pressure": 100e3}, 0.025, BODY),
    ],
)
def test_a_moment_varies_along_the_robot(name, states, law, cells):
    s = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    x = section(s=s, **{k: np.full(5, value) for k, value in states.items()})
    waves = [np.cos(n * np.pi * s / 0.4) for n in (1, 2, 3)]
    along = 0.1 * waves[0] + 0.2 * waves[1] + 0.4 * waves[2]
    np.testing.assert_allclose(moment(name, x, 0.4), law * along * cells, atol=1e-12)


def test_the_added_mass_varies_along_the_robot():
    """The force is 10 N/m per unit of a parameter, at 10 m/s^2."""
    s = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    x = section(s=s, u_n_t=np.full(5, 5.0))
    waves = [np.cos(n * np.pi * s / 0.4) for n in (1, 2, 3)]
    along = 0.1 * waves[0] + 0.2 * waves[1] + 0.4 * waves[2]
    np.testing.assert_allclose(force("added_mass_along_robot", x, 0.4), 5.0 * along, atol=1e-12)


def test_the_drag_differs_while_the_speed_grows_and_while_it_decreases():
    """Both signs of the speed, growing and decreasing, and a constant speed."""
    speed = np.array([0.5, -0.5, 0.5, -0.5, 0.5])
    x = section(u_n=speed, u_n_t=np.array([20.0, -20.0, -20.0, 20.0, 0.0]))
    found = force("drag_of_acceleration", x, 20.0)
    q = 1.0 / np.sqrt(1.01)  # the sign of u_n has a smooth corner
    size = np.sqrt(q**2 + 0.01)
    grows = 10.0 * (0.1 * q / size + 0.2 * q + 0.4 * size)
    shrinks = 10.0 * (-0.1 * q / size - 0.2 * q + 0.4 * size)
    expected = np.array([grows, -grows, shrinks, -shrinks, 10.0 * 0.4 * 0.1])
    np.testing.assert_allclose(found, expected)


def test_forces_depend_on_the_angle_of_the_robot():
    x = section(phi=0.5 * Z, u_n=np.full(5, -1.0), u_n_t=np.full(5, 5.0))
    np.testing.assert_allclose(force("drag_of_angle", x, 0.5), 10.0 * MIXED * -4.0)
    np.testing.assert_allclose(force("added_mass_of_angle", x, 0.5), 10.0 * MIXED * 0.5)
    np.testing.assert_allclose(force("normal_force_of_angle", x, 0.5), 10.0 * ODD)


def test_a_normal_force_depends_on_both_velocities():
    x = section(u_tau=0.3 * Z, u_n=np.full(5, 0.25))
    found = force("normal_force_of_axial_velocity", x, 0.3)
    np.testing.assert_allclose(found, 10.0 * MIXED * 0.5)


def drift(q):
    """Drift with the parameters FACTORS at the time q, divided by its scale."""
    return 0.1 * q + 0.2 * (1.0 - np.exp(-q / 0.3)) + 0.4 * (1.0 - np.exp(-q / 0.1))


@pytest.mark.parametrize(("name", "axis"), [("water_drift_along", 0), ("water_drift_across", 1)])
def test_the_current_drifts_along_one_axis(name, axis):
    velocity = DICTIONARY[name](**FACTORS, scale=2.0).velocity(jnp.array([0.0, 1.0, 2.0, 5.0]))
    np.testing.assert_allclose(velocity[axis], 0.05 * drift(np.array([0.0, 0.5, 1.0, 1.0])))
    np.testing.assert_array_equal(velocity[1 - axis], 0.0)


def test_the_acting_pressure_depends_on_the_other_chamber():
    """One unit of a parameter is 20 kPa. The pressures are 100 and -50 kPa."""
    p, memory = jnp.array([100e3, -50e3]), jnp.zeros((2, 2))
    other = DICTIONARY["acting_pressure_of_other"](**FACTORS, scale=200e3)
    found, _ = other.act(p, memory, 1e-3)
    change = 20e3 * np.array([-0.025 + 0.05 + 0.025, 0.05 + 0.1 + 0.1])
    np.testing.assert_allclose(found - p, change)
    difference = DICTIONARY["acting_pressure_of_difference"](**FACTORS, scale=300e3)
    found, _ = difference.act(p, memory, 1e-3)
    one = 20e3 * (0.05 + 0.05 + 0.05)
    np.testing.assert_allclose(found - p, [one, -one])


@pytest.mark.parametrize(("name", "acts"), [("front", [1.0, 0.0]), ("rear", [0.0, 1.0])])
def test_the_opening_of_one_chamber_depends_on_the_difference(name, acts):
    x, rate = chambers([60e3, -160e3], [160e3, -60e3]), jnp.zeros(2)
    found = DICTIONARY[f"{name}_opening_of_difference"](**FACTORS, scale=200e3).rate(rate, x)
    opening = 12.5 * np.array([0.05 + 0.1 + 0.1, -0.05 + 0.1 + 0.1])
    np.testing.assert_allclose(found, opening * 100e3 * np.array(acts))


@pytest.mark.parametrize(("name", "acts"), [("front", [1.0, 0.0]), ("rear", [0.0, 1.0])])
def test_the_opening_of_one_chamber_depends_on_the_other_chamber(name, acts):
    x = chambers([-100e3, 100e3], [-150e3, 150e3])
    found = DICTIONARY[f"{name}_opening_of_other"](**FACTORS, scale=200e3).rate(jnp.zeros(2), x)
    opening = 12.5 * (0.05 + 0.05 + 0.05)
    np.testing.assert_allclose(found, opening * np.array([-50e3, 50e3]) * np.array(acts))


def test_only_a_set_pressure_with_the_sign_of_the_pressure_changes_the_opening():
    x = chambers([-50e3, 50e3], [-100e3, -100e3])
    term = DICTIONARY["opening_of_set_pressure"](**FACTORS, scale=200e3)
    found = term.rate(jnp.zeros(2), x)
    np.testing.assert_allclose(found, [12.5 * -50e3 * (0.05 + 0.05 + 0.05), 0.0])


def test_the_opening_of_the_rear_chamber_depends_on_its_pressure():
    x = chambers([100e3, 100e3], [200e3, 200e3])
    found = DICTIONARY["rear_opening"](**FACTORS, scale=200e3).rate(jnp.zeros(2), x)
    np.testing.assert_allclose(found, [0.0, 12.5 * 100e3 * (0.05 + 0.05 + 0.05)])


def test_the_opening_follows_the_recent_flow():
    """After a constant flow of 1.25 MPa/s with k = 0.08 s, the recent flow is 100 kPa."""
    filling, venting = [150e3, -100e3], [50e3, 0.0]
    p, rate = [100e3, -50e3], jnp.array([1.25e6, -1.25e6])
    names = "filling_opening_of_recent_flow", "venting_opening_of_recent_flow"
    for p_set, acts in ((filling, [1.0, 0.0]), (venting, [0.0, 1.0])):
        x = chambers(p, p_set, [[100e3, 100e3]])
        for name, acting in zip(names, acts, strict=True):
            term = DICTIONARY[name](**FACTORS, scale=200e3)
            change = np.asarray(term.rate(rate, x) - rate)
            opening = 12.5 * (0.05 + 0.05 + 0.05)
            expected = acting * opening * (np.array(p_set) - np.array(p))
            np.testing.assert_allclose(change, expected)
            np.testing.assert_allclose(term.state_rates(rate, x), [[0.0, 0.0]], atol=1e-6)
    start = DICTIONARY[names[0]]().state_rates(rate, chambers(p, filling, [[0.0, 40e3]]))
    np.testing.assert_allclose(start, [[100e3 / 0.3, 60e3 / 0.3]])


def test_the_set_pressure_changes_by_an_odd_or_an_even_function():
    """One unit of a parameter is 20 kPa."""
    wave = SquareWave(jnp.asarray(1.0), jnp.asarray(100e3))
    for name, sign in (("set_pressure_powers", -1.0), ("set_pressure_powers_by_side", 1.0)):
        changed = DICTIONARY[name](**FACTORS, scale=200e3).command(wave, 0)
        x = changed.segment(jnp.asarray(0.4), jnp.asarray(0.6))
        change = 20e3 * (0.05 + 0.05 + 0.05)
        np.testing.assert_allclose([x.a0, x.b1], [100e3 + change, -100e3 + sign * change])


def test_the_delay_of_the_set_pressure_drifts():
    """One unit is 2 ms. The edge at 0.5 s is late by its own delay at the time of the edge."""
    wave = SquareWave(jnp.asarray(1.0), jnp.asarray(100e3))
    late = DICTIONARY["set_pressure_delay_drift"](**FACTORS, scale=2.0).command(wave, 0)
    x = late.segment(jnp.asarray(0.45), jnp.asarray(0.6))
    t = float(x.t_break)
    q = t / 2.0
    assert t == pytest.approx(0.5 + 0.002 * drift(q), abs=1e-12)
    assert (float(x.a0), float(x.b1)) == (100e3, -100e3)
    none = late.segment(jnp.asarray(0.6), jnp.asarray(0.7))
    assert float(none.t_break) == 0.7 and float(none.a0) == float(none.b1) == -100e3


@pytest.mark.parametrize(("up", "down"), [(3e-3, 1e-3), (1e-3, 3e-3), (-1e-3, 2e-3)])
def test_rising_and_falling_edges_have_their_own_delays(up, down):
    """The edges of the square wave are at 0.5 s (falling) and at 1 s (rising)."""
    wave = SquareWave(jnp.asarray(1.0), jnp.asarray(100e3))
    term = DICTIONARY["set_pressure_delay_of_edges"](a=up / 2e-3, b=down / 2e-3)
    t0 = np.arange(0.49, 1.01, 3.7e-4)
    t1 = t0 + 3.7e-4
    x = jax.vmap(term.command(wave, 0).segment)(jnp.asarray(t0), jnp.asarray(t1))
    first, second = 0.5 + down, 1.0 + up
    breaks = np.asarray(x.t_break)
    np.testing.assert_allclose(breaks[breaks < t1], [first, second], atol=1e-12)
    for t, value in ((t0, x.a0), (t1, x.b1)):
        np.testing.assert_array_equal(value, np.where((t > first) & (t < second), -100e3, 100e3))


@pytest.mark.parametrize(("t0", "name"), [(0.49, "b"), (0.99, "a")])
def test_a_delay_of_edges_at_its_null_moves_only_its_own_edges(t0, name):
    wave = SquareWave(jnp.asarray(1.0), jnp.asarray(100e3))

    def t_break(x):
        late = DICTIONARY["set_pressure_delay_of_edges"](**x).command(wave, 0)
        return late.segment(t0, t0 + 0.02).t_break

    slope = jax.grad(t_break)({"a": 0.0, "b": 0.0})
    assert {key: float(x) for key, x in slope.items()} == {"a": 0.0, "b": 0.0} | {name: 2e-3}


def test_a_smooth_wave_is_delayed_where_it_rises_and_where_it_falls():
    wave = SineWave(jnp.asarray(1.0), jnp.asarray(100e3))
    late = DICTIONARY["set_pressure_delay_of_edges"](a=5.0, b=-2.0).command(wave, 0)
    for t0, delay in ((1.0, 0.01), (0.5, -0.004)):
        x = late.segment(jnp.asarray(t0), jnp.asarray(t0 + 1e-3))
        assert float(x.a0) == pytest.approx(100e3 * np.sin(2.0 * np.pi * (t0 - delay)), rel=1e-9)


@pytest.mark.parametrize("edge", [0.1, 0.3, 0.7, 1.1, 1.5])
def test_an_edge_at_the_start_of_a_step_has_the_whole_derivative_by_a_delay(edge):
    """At the null, the derivative of the edge by a is 2 ms times t/scale."""
    wave, h = SquareWave(jnp.asarray(5.0), jnp.asarray(100e3)), 1e-3

    def t_break(a, t0):
        late = DICTIONARY["set_pressure_delay_drift"](a=a, scale=2.0).command(wave, 0)
        return late.segment(t0, t0 + h).t_break

    found = jax.grad(t_break)(0.0, h * round(edge / h))
    assert float(found) == pytest.approx(2e-3 * edge / 2.0, rel=1e-9)


SENSORS = {"pressure": 1e5, "thrust": 0.2, "recoil": 1.0, "tip": 0.02}


def readings(scale=1.0):
    """Readings of all sensors in a parabola of the time, in units of their scale."""
    t = 0.01 * np.arange(101.0)
    y = scale * t**2
    return slider_readings(*map(jnp.asarray, (t, 1e5 * y, 1e5 * y, 0.2 * y, y, 0.02 * y)))


def field(read, sensor):
    return np.asarray(read.pressures[1] if sensor == "pressure" else getattr(read, sensor))


@pytest.mark.parametrize("sensor", SENSORS)
def test_an_error_depends_on_the_rate_of_the_reading(sensor):
    true, scale = readings(), SENSORS[sensor]
    read = DICTIONARY[f"{sensor}_reading_of_rate"](**FACTORS, scale=0.2).read(true)
    q = 0.05 * 2.0 * np.asarray(true.t) / 0.2
    error = scale * (0.1 * q + 0.2 * q**2 + 0.4 * q**3)
    np.testing.assert_allclose((field(read, sensor) - field(true, sensor))[1:-1], error[1:-1])


def test_a_rate_does_not_depend_on_the_first_interval():
    """The first reading is at 0, and the others are late by 0.5 ms."""
    t = np.array([0.0, *(0.0005 + 0.01 * np.arange(50))])
    y = jnp.asarray(3e5 * t)
    true = slider_readings(jnp.asarray(t), *(5 * [y]))
    rate = DICTIONARY["pressure_reading_of_rate"]().state(true)
    np.testing.assert_allclose(rate, 0.05 * 3.0)


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_gain_of_a_sensor_oscillates(sensor):
    true = readings()
    term = DICTIONARY[f"{sensor}_reading_gain_sine"](a=0.3, b=-0.1, frequency=2.5)
    angle = 2.0 * np.pi * 2.5 * np.asarray(true.t)
    gain = 1.0 + 0.3 * np.sin(angle) - 0.1 * np.cos(angle)
    read = term.read(true)
    np.testing.assert_allclose(field(read, sensor), gain * field(true, sensor), atol=1e-12)
    others = set(true._fields) - {sensor, "pressures"}
    assert all(np.array_equal(getattr(read, n), getattr(true, n)) for n in others)


PAIRS = [("thrust", "recoil"), ("recoil", "thrust"), ("tip", "pressure"), ("tip", "recoil")]


@pytest.mark.parametrize(("sensor", "other"), [*PAIRS, ("pressure", "tip")])
def test_an_error_depends_on_another_sensor(sensor, other):
    true, scale = readings(), SENSORS[sensor]
    read = DICTIONARY[f"{sensor}_reading_of_{other}"](**FACTORS, scale=2.0).read(true)
    q = np.asarray(true.t) ** 2 / 2.0
    error = scale * (0.1 * q + 0.2 * q + 0.4 * q**2)
    count = 2 if other == "pressure" else 1  # both chambers have the same pressure
    np.testing.assert_allclose(field(read, sensor) - field(true, sensor), count * error)


CORNERS = np.sign(Z) * sum(
    f * np.maximum(np.abs(Z) - k, 0.0) for f, k in ((0.1, 0.25), (0.2, 0.5), (0.4, 0.75))
)


def test_moments_have_corners():
    x = section(kappa=2.0 * Z, pressure=150e3 * Z)
    for name, cells in (("body", BODY), ("tail", 1.0 - BODY)):
        found = moment(f"moment_of_{name}_with_corners", x, 2.0)
        np.testing.assert_allclose(found, 0.04 * 2.0 * CORNERS * cells)
    found = moment("moment_of_pressure_with_corners", x, 150e3)
    np.testing.assert_allclose(found, 0.05 * CORNERS * BODY)


def test_the_normal_force_has_corners():
    found = force("normal_force_with_corners", section(u_n=0.5 * Z), 0.5)
    np.testing.assert_allclose(found, 10.0 * CORNERS)


def test_flow_and_set_pressure_have_corners():
    """One unit of a parameter is 3 MPa/s, or 20 kPa. The state is the whole scale."""
    whole = 0.1 * 0.75 + 0.2 * 0.5 + 0.4 * 0.25
    x, rate = chambers([200e3, -200e3], [0.0, 100e3]), jnp.zeros(2)
    flow = DICTIONARY["flow_of_pressure_with_corners"](**FACTORS, scale=200e3)
    np.testing.assert_allclose(flow.rate(rate, x), 3e6 * whole * np.array([1.0, -1.0]))
    flow = DICTIONARY["flow_of_difference_with_corners"](**FACTORS, scale=200e3)
    np.testing.assert_allclose(flow.rate(rate, x), 3e6 * whole * np.array([-1.0, 1.0]))
    wave = SquareWave(jnp.asarray(1.0), jnp.asarray(100e3))
    term = DICTIONARY["set_pressure_with_corners"](**FACTORS, scale=100e3)
    found = term.command(wave, 0).segment(jnp.asarray(0.4), jnp.asarray(0.6))
    np.testing.assert_allclose([found.a0, found.b1], [100e3 + 20e3 * whole, -100e3 - 20e3 * whole])


def test_the_flow_depends_on_the_size_of_the_difference_or_on_the_other_chamber():
    """One unit of a parameter is 3 MPa/s. The differences are 100 and -50 kPa."""
    x, rate = chambers([100e3, -50e3], [200e3, -100e3]), jnp.zeros(2)
    of_size = DICTIONARY["flow_of_difference_by_side"](**FACTORS, scale=200e3)
    small, large = 0.025 + 0.0125 + 0.00625, 0.05 + 0.05 + 0.05
    np.testing.assert_allclose(of_size.rate(rate, x), 3e6 * np.array([large, small]))
    of_other = DICTIONARY["flow_of_other_difference"](**FACTORS, scale=200e3)
    front, rear = -0.025 + 0.05 + 0.025, 0.05 + 0.1 + 0.1
    np.testing.assert_allclose(of_other.rate(rate, x), 3e6 * np.array([front, rear]))


@pytest.mark.parametrize("sensor", ["pressure", "thrust", "recoil", "tip"])
def test_the_error_of_a_sensor_has_corners(sensor):
    scale = {"pressure": 100e3, "thrust": 0.2, "recoil": 1.0, "tip": 0.02}[sensor]
    true = slider_readings(jnp.arange(5.0), *(5 * [jnp.asarray(2.0 * scale * Z)]))
    read = DICTIONARY[f"{sensor}_reading_with_corners"](**FACTORS, scale=2.0).read(true)
    changed = ("p_front", "p_rear") if sensor == "pressure" else (sensor,)
    for name in SLIDER_CHANNELS:
        error = np.asarray(reading(read, name) - reading(true, name))
        np.testing.assert_allclose(error, scale * CORNERS * (name in changed), atol=1e-12)


def test_the_flow_follows_the_lagged_difference():
    """One unit of a parameter changes dp/dt by 3 MPa/s at a lagged difference of 250 kPa."""
    term = DICTIONARY["flow_of_lagged_difference"](**FACTORS)
    states = np.array([[250e3, 0.0], [0.0, 125e3], [0.0, -250e3]])
    x = chambers([100e3, -50e3], [200e3, -50e3], states)
    found = term.rate(jnp.array([1e6, 0.0]), x)
    np.testing.assert_allclose(found, [1e6 + 0.3e6, 3e6 * (0.1 - 0.4)])
    lag = np.array([[0.03], [0.3], [3.0]])
    np.testing.assert_allclose(term.state_rates(found, x), ([100e3, 0.0] - states) / lag)
    z = np.array([0.0, 0.3])
    step = [3e6 * (1.0 - np.exp(-z / tau)) for tau in (0.03, 0.3, 3.0)]
    np.testing.assert_allclose(term.basis(jnp.asarray(z)), step)


def test_terms_of_one_chamber_leave_the_other_chamber_unchanged():
    """Pressures of 50 and -100 kPa, differences of 150 and 50 kPa."""
    x, rate = chambers([50e3, -100e3], [200e3, -50e3]), jnp.zeros(2)
    mixed = (
        0.1 * np.array([-0.5, 0.25]) + 0.2 * np.array([0.5, 0.25]) + 0.4 * np.array([0.25, 0.0625])
    )
    for name, value in (("pressure", mixed[0]), ("difference", mixed[1])):
        found = DICTIONARY[f"rear_flow_of_{name}"](**FACTORS, scale=200e3).rate(rate, x)
        np.testing.assert_allclose(found, [0.0, 3e6 * value])
    even = 0.1 * 0.25 + 0.2 * 0.25**2 + 0.4 * 0.25**3
    for name, expected in (("front", [150e3, 0.0]), ("rear", [0.0, 50e3])):
        found = DICTIONARY[f"{name}_opening_of_sum"](**FACTORS, scale=200e3).rate(rate, x)
        np.testing.assert_allclose(found, 12.5 * even * np.array(expected))


def test_the_set_pressure_of_the_rear_chamber_changes():
    wave = SquareWave(jnp.asarray(1.0), jnp.asarray(100e3))
    term = DICTIONARY["rear_set_pressure"](**FACTORS, scale=200e3)
    first = term.command(wave, 0).segment(jnp.asarray(0.4), jnp.asarray(0.6))
    np.testing.assert_array_equal([first.a0, first.b1], [100e3, -100e3])
    x = term.command(wave, 1).segment(jnp.asarray(0.4), jnp.asarray(0.6))
    up, down = 0.05 + 0.1 + 0.1, -0.05 + 0.1 + 0.1
    np.testing.assert_allclose([x.a0, x.b1], [100e3 + 20e3 * up, -100e3 + 20e3 * down])


@pytest.mark.parametrize("name", ["set_pressure_gain_drift", "rear_set_pressure_gain_drift"])
def test_the_gain_of_the_set_pressure_drifts(name):
    """One unit of a parameter is a gain error of 10 %, at the end of the scale."""
    wave = SquareWave(jnp.asarray(1.0), jnp.asarray(100e3))
    term = DICTIONARY[name](**FACTORS, scale=2.0)
    x = term.command(wave, 1).segment(jnp.asarray(0.4), jnp.asarray(0.6))
    q = np.array([0.2, 0.25, 0.25, 0.3])
    gain = 1.0 + 0.1 * drift(q)
    signs = np.array([1.0, 1.0, -1.0, -1.0])
    np.testing.assert_allclose([x.a0, x.a1, x.b0, x.b1], 100e3 * gain * signs)
    first = term.command(wave, 0).segment(jnp.asarray(0.4), jnp.asarray(0.6))
    assert bool(first.a1 == 100e3) == name.startswith("rear")


def test_the_set_pressure_contains_a_sine():
    """On both sides of an edge at 0.5 s; a is 0.1, b is 0.2, and the frequency is 7 Hz."""
    wave = SquareWave(jnp.asarray(1.0), jnp.asarray(100e3))
    turn = 2.0 * np.pi * 7.0 * np.array([0.4, 0.5, 0.5, 0.6])
    sine, plain = 0.1 * np.sin(turn) + 0.2 * np.cos(turn), 100e3 * np.array([1.0, 1.0, -1.0, -1.0])
    expected = {"gain_sine": plain * (1.0 + sine), "sine": plain + 100e3 * sine}
    for name, values in expected.items():
        term = DICTIONARY[f"set_pressure_{name}"](a=0.1, b=0.2, frequency=7.0)
        x = term.command(wave, 1).segment(jnp.asarray(0.4), jnp.asarray(0.6))
        np.testing.assert_allclose([x.a0, x.a1, x.b0, x.b1], values)
        assert float(x.t_break) == 0.5


def test_the_front_pressure_sensor_has_its_own_error():
    p = 100e3 * jnp.asarray(Z)
    true = slider_readings(jnp.arange(5.0), *(5 * [p]))
    read = DICTIONARY["front_pressure_reading"](**FACTORS, scale=1.0).read(true)
    np.testing.assert_allclose(read.pressures[0] - p, 100e3 * MIXED)
    np.testing.assert_array_equal(read.pressures[1], p)
    both = DICTIONARY["pressure_reading_hysteresis"](**FACTORS).read(true)
    front = DICTIONARY["front_pressure_reading_hysteresis"](**FACTORS).read(true)
    np.testing.assert_array_equal(front.pressures[1], p)
    np.testing.assert_array_equal(front.pressures[0], both.pressures[0])
    np.testing.assert_array_equal(both.pressures[0], both.pressures[1])
    step = 100e3 * sum(
        f * (1.0 - np.exp(-0.5 / w)) for f, w in zip((0.1, 0.2, 0.4), (0.1, 0.3, 1.0), strict=True)
    )
    assert float(both.pressures[0, 1] - p[1]) == pytest.approx(step, rel=1e-9)


@pytest.mark.parametrize(("name", "acts"), [("opening_drift", 1.0), ("rear_opening_drift", 0.0)])
def test_the_opening_of_the_valves_drifts(name, acts):
    """The state is the time. One unit changes 1/k by 12.5 1/s."""
    x = chambers([50e3, -100e3], [200e3, -50e3], [[1.0, 1.0]])
    term = DICTIONARY[name](**FACTORS, scale=2.0)
    change = 12.5 * drift(0.5) * np.array([acts * 150e3, 50e3])
    np.testing.assert_allclose(term.rate(jnp.zeros(2), x), change)
    np.testing.assert_array_equal(term.state_rates(jnp.zeros(2), x), [[1.0, 1.0]])


def test_forces_depend_on_the_pressure_and_on_the_rotation():
    x = section(pressure=150e3 * Z, u_n=np.full(5, -1.0), u_n_t=np.full(5, 5.0))
    np.testing.assert_allclose(force("drag_of_pressure", x, 150e3), 10.0 * MIXED * -4.0 * BODY)
    np.testing.assert_allclose(force("added_mass_of_pressure", x, 150e3), 10.0 * MIXED * 0.5 * BODY)
    x = section(u_n=np.full(5, -0.25), omega=20.0 * Z)
    F_tau, F_n = DICTIONARY["normal_force_of_rotation"](body=3.0, tail=-2.0).force(x)
    np.testing.assert_array_equal(F_tau, 0.0)
    np.testing.assert_allclose(F_n, np.where(BODY > 0, 3.0, -2.0) * 0.5 * 2.0 * Z)


def test_a_one_sided_moment_has_corners():
    found = moment("moment_of_body_by_side_with_corners", section(kappa=2.0 * Z), 2.0)
    np.testing.assert_allclose(found, 0.04 * 2.0 * np.abs(CORNERS) * BODY)


def test_dry_friction_depends_on_the_curvature():
    """After bending far, the state of dry friction is 1."""
    x = section(kappa=2.0 * Z, kappa_t=np.full(5, 1e4))
    term = DICTIONARY["friction_of_curvature"](**FACTORS, scale=2.0)
    found, q = term.moment(x, jnp.zeros(5), 1.0)
    np.testing.assert_allclose(q, 1.0, rtol=1e-3)
    even = 0.1 * np.abs(Z) + 0.2 * Z**2 + 0.4 * np.abs(Z) ** 3
    np.testing.assert_allclose(found, 0.04 * 2.0 * even * BODY * q)
