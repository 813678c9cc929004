"""Tests of the clock against numerical integrals of its frequency."""

import jax.numpy as jnp
import numpy as np

from slider_jax.beam.clock import Clock


def test_turns_are_the_integral_of_the_frequency_from_the_first_time():
    times, f = np.array([0.5, 1.0, 3.0]), np.array([2.0, 5.0, 1.0])
    clock = Clock(jnp.asarray(times), jnp.asarray(f))
    for t in (-0.3, 0.5, 0.7, 1.0, 2.2, 3.0, 7.5):
        at = np.linspace(0.5, t, 200001)
        expected = np.trapezoid(np.interp(at, times, f), at)
        np.testing.assert_allclose(clock.turns(jnp.asarray(t)), expected, atol=1e-8)


def test_a_single_knot_is_a_constant_frequency():
    clock = Clock(jnp.array([0.0]), jnp.array([3.0]))
    np.testing.assert_allclose(clock.turns(jnp.array([-1.0, 0.0, 2.5])), [-3.0, 0.0, 7.5])
