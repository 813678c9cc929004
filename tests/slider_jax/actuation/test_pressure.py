"""Pressure of a chamber against closed forms; set pressures whose breaks miss the steps."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation import FirstOrderLag, Ideal, Recorded, SineWave, SquareWave, Trapezoid
from tests.support import chambers
from tests.support.helpers import order

K, F, A = 0.087, 2.2, 250e3
LAG = FirstOrderLag(K)

pressure_history = eqx.filter_jit(chambers.pressure_history)


def periodic_state(t, phase=0.0):
    """p(t) [Pa] of a lag K driven for ever by a square wave.

    With tau since the last switch, p = sign (A - (A + p_end) exp(-tau/K)) and
    p_end = A tanh(1/(4 f K)).
    """
    turn = np.asarray(F * t - phase)
    half = np.floor(2.0 * turn + 1e-9)
    since = (turn - half / 2.0) / F
    p_end = A * np.tanh(1.0 / (4.0 * F * K))
    return np.where(half % 2 == 0, 1.0, -1.0) * (A - (A + p_end) * np.exp(-since / K))


def on_edges():
    return np.arange(0, 221) / (F * 20)


def off_edges():
    """Uneven steps of up to 0.4 of a period: none of them ends on an edge."""
    steps = np.random.default_rng(0).uniform(0.01, 0.4, 100) / F
    return np.concatenate([[0.0], np.cumsum(steps)])


@pytest.mark.parametrize("times", [on_edges, off_edges])
@pytest.mark.parametrize("phase", [0.0, 0.15, -0.4])
def test_periodic_state_is_the_closed_form(times, phase):
    t = times()
    start = periodic_state(t[0], phase)
    p = pressure_history(LAG, SquareWave(F, A, phase), start, jnp.asarray(t))
    off = np.max(np.abs(p - periodic_state(t, phase))) / A
    print(f"off by {off:.1e} of the amplitude")
    assert off < 1e-10


def test_the_pressure_settles_into_the_periodic_state_from_rest():
    t = np.arange(0, 2001) / (F * 20)
    p = pressure_history(LAG, SquareWave(F, A), 0.0, jnp.asarray(t))
    assert np.max(np.abs(p - periodic_state(t))[-20:]) / A < 1e-10
    assert abs(float(p[0])) == 0.0


def lagged(value, breaks, p0, t):
    """p(t) by Gauss quadrature of exp(-(t - s)/K) value(s)/K between the breaks of `value`."""
    x, w = np.polynomial.legendre.leggauss(24)
    out = []
    for end in t:
        inside = [b for b in breaks if 0.0 < b < end]
        edges = np.array([0.0, *inside, end])
        mid, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
        s = mid[:, None] + half[:, None] * x
        integral = np.sum(half[:, None] * w * np.exp(-(end - s) / K) * value(s) / K)
        out.append(p0 * np.exp(-end / K) + integral)
    return np.array(out)


def test_recorded_drive_is_exact_between_its_samples():
    rng = np.random.default_rng(1)
    at = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.03, 60))])
    values = rng.uniform(-A, A, at.size)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.001, 0.0099, 150))])
    drive = Recorded(jnp.asarray(at), jnp.asarray(values))
    p = pressure_history(LAG, drive, 1e4, jnp.asarray(t))
    exact = lagged(lambda s: np.interp(s, at, values), at, 1e4, t)
    assert np.max(np.abs(p - exact)) / A < 1e-10


def test_recorded_drive_holds_its_ends():
    drive = Recorded(jnp.asarray([0.1, 0.2]), jnp.asarray([1.0, 3.0]))
    p = pressure_history(Ideal(), drive, 0.0, jnp.linspace(0.0, 0.4, 41))
    np.testing.assert_allclose(p[1:10], 1.0)
    np.testing.assert_allclose(p[20:], 3.0)
    np.testing.assert_allclose(p[15], 2.0, rtol=1e-12)


@pytest.mark.parametrize("phase", [0.0, 0.23])
def test_trapezoid_is_exact_for_steps_that_miss_its_corners(phase):
    rise = 0.2
    corners = (np.arange(-2, 60)[:, None] / 2.0 + np.array([-0.1, 0.1]) + phase).ravel() / F

    def value(s):
        turn = F * s - phase
        corner = [-0.1, 0.1, 0.4, 0.6, 0.9]
        return A * np.interp((turn + 0.1) % 1.0 - 0.1, corner, [-1.0, 1.0, 1.0, -1.0, -1.0])

    steps = np.random.default_rng(2).uniform(0.01, 0.15, 80) / F
    t = np.concatenate([[0.0], np.cumsum(steps)])
    p = pressure_history(LAG, Trapezoid(F, A, phase, rise), -2e4, jnp.asarray(t))
    off = np.max(np.abs(p - lagged(value, np.sort(corners), -2e4, t))) / A
    assert off < 1e-10


def test_sine_is_second_order_in_the_step():
    def error(steps):
        t = np.linspace(0.0, 3.0 / F, 3 * steps + 1)
        p = pressure_history(LAG, SineWave(F, A), 0.0, jnp.asarray(t))
        turn, lag = 2.0 * np.pi * F, 2.0 * np.pi * F * K
        swing = np.sin(turn * t) - lag * np.cos(turn * t) + lag * np.exp(-t / K)
        return np.max(np.abs(p / A - swing / (1.0 + lag**2)))

    steps = np.array([10, 20, 40, 80])
    slope = -order(steps, [error(n) for n in steps])
    assert slope == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("argument", ["frequency", "phase", "k"])
def test_pressure_is_differentiable_to_the_time_of_an_edge(argument):
    t = jnp.asarray(off_edges()[:20])

    def last(frequency=F, phase=0.13, k=K):
        p = pressure_history(FirstOrderLag(k), SquareWave(frequency, A, phase), 0.0, t)
        return p[-1] / A

    at = {"frequency": F, "phase": 0.13, "k": K}[argument]
    value = lambda x: last(**{argument: x})  # noqa: E731
    h = 1e-6 * at
    central = (value(at + h) - value(at - h)) / (2.0 * h)
    assert float(jax.grad(value)(at)) == pytest.approx(float(central), rel=1e-6)


@pytest.mark.parametrize("argument", ["frequency", "phase"])
def test_edges_on_steps_have_the_derivative_of_the_closed_form(argument):
    """All edges of phase 0.15 fall on these twentieths of a period; none on the last time."""
    t = jnp.asarray(on_edges()[:46])

    def last(**changed):
        wave = SquareWave(**({"frequency": F, "amplitude": A, "phase": 0.15} | changed))
        return pressure_history(LAG, wave, 0.0, t)[-1] / A

    at = {"frequency": F, "phase": 0.15}[argument]
    h = 1e-6 * at
    central = (last(**{argument: at + h}) - last(**{argument: at - h})) / (2.0 * h)
    slope = float(jax.grad(lambda x: last(**{argument: x}))(at))
    assert abs(slope) > 0.1
    assert slope == pytest.approx(float(central), rel=1e-5)


@pytest.mark.parametrize("times", [on_edges, off_edges])
def test_no_lag_follows_the_set_pressure(times):
    t = jnp.asarray(times())
    ideal = pressure_history(Ideal(), SquareWave(F, A), 0.0, t)[1:]
    quick = pressure_history(FirstOrderLag(1e-9), SquareWave(F, A), 0.0, t)[1:]
    none = pressure_history(FirstOrderLag(0.0), SquareWave(F, A), 0.0, t)[1:]
    np.testing.assert_array_equal(none, ideal)
    away = np.abs((F * t[1:]) % 0.5 - 0.25) < 0.249
    np.testing.assert_allclose(quick[away], ideal[away], rtol=1e-12)
    assert np.all(np.abs(ideal) == A)
