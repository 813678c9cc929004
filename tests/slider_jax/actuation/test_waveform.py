"""Periodic splines and biased waveforms, and the values of waveforms at a time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from slider_jax.actuation import Biased, Held, PeriodicSpline, Recorded, SineWave, SquareWave

F = 2.0


@pytest.mark.parametrize("samples", [5, 8])
def test_periodic_spline_is_that_of_scipy(samples):
    """Value and derivative to 1e-12, over several periods, with a delay."""
    values = np.random.default_rng(0).normal(size=samples)
    wave = PeriodicSpline(F, jnp.asarray(values), 0.3)
    knots = np.append(values, values[0])
    exact = CubicSpline(np.arange(samples + 1) / (samples * F), knots, bc_type="periodic")
    t = np.linspace(-0.4, 1.3, 301)
    found, rate = jax.vmap(lambda t: jax.jvp(wave.at, (t,), (jnp.ones_like(t),)))(jnp.asarray(t))
    shifted = np.mod(t - 0.3 / F, 1.0 / F)
    np.testing.assert_allclose(found, exact(shifted), atol=1e-12)
    np.testing.assert_allclose(rate, exact(shifted, 1), atol=1e-10)


def test_spline_of_a_sine_converges_with_the_fourth_order():
    t = jnp.linspace(0.0, 1.0, 200)
    errors = []
    for n in (8, 16, 32):
        wave = PeriodicSpline(F, jnp.sin(2.0 * np.pi * jnp.arange(float(n)) / n))
        exact = jax.vmap(SineWave(F, 1.0).at)(t)
        errors.append(float(jnp.max(jnp.abs(jax.vmap(wave.at)(t) - exact))))
    print("errors", errors)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(4.0, abs=0.2)


def test_bias_adds_to_all_values_of_a_segment():
    wave, t0, t1 = SquareWave(F, 3.0, 0.1), jnp.asarray(0.2), jnp.asarray(0.35)
    plain, biased = wave.segment(t0, t1), Biased(wave, 0.5).segment(t0, t1)
    for name in ("a0", "a1", "b0", "b1"):
        assert float(getattr(biased, name) - getattr(plain, name)) == pytest.approx(0.5)
    for name in ("t0", "t_break", "t1"):
        assert float(getattr(biased, name)) == float(getattr(plain, name))


def test_value_at_a_time():
    times, values = jnp.array([0.0, 1.0, 2.0]), jnp.array([1.0, 3.0, 2.0])
    at = jnp.asarray(1.5)
    assert float(Recorded(times, values).at(at)) == pytest.approx(2.5)
    assert float(Held(times, values).at(at)) == 3.0
    assert float(SquareWave(F, 3.0).at(jnp.asarray(0.3))) == -3.0
