"""Tests of the square wave with a schedule against the periodic square wave and its definition."""

import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.actuation import ScheduledSquareWave, SquareWave
from slider_jax.beam.clock import Clock

STEP = 2.5e-3


def segments(wave, count):
    t = STEP * jnp.arange(count + 1.0)
    return jax.vmap(wave.segment)(t[:-1], t[1:])


def constant(*values):
    return jnp.full(2, 1.0) * jnp.asarray(values)


def test_a_constant_schedule_is_the_periodic_square_wave():
    clock = Clock(jnp.array([0.0, 1.0]), constant(3.3, 3.3))
    wave = ScheduledSquareWave(clock, constant(2e5, 2e5), constant(0.13, 0.13), jnp.zeros(2))
    found, expected = (segments(w, 800) for w in (wave, SquareWave(3.3, 2e5, 0.13)))
    for name in ("t_break", "a0", "a1", "b0", "b1"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), atol=1e-9, err_msg=name
        )


def test_edges_are_where_the_delayed_clock_has_made_half_turns():
    """Frequency, amplitude, delay and bias change; each edge is exact to second order."""
    clock = Clock(jnp.array([0.2, 1.0, 1.5]), jnp.array([5.0, 2.0, 4.0]))
    rows = jnp.array([1e5, 3e5, 2e5]), jnp.array([0.0, 0.2, 0.1]), jnp.array([0.0, 5e4, -2e4])
    wave = ScheduledSquareWave(clock, *rows)
    x = segments(wave, 800)
    edges = np.asarray(x.t_break)[np.asarray(x.a1 != x.b0)]
    delay = np.interp(edges, clock.times, rows[1])
    turns = np.asarray(clock.turns(jnp.asarray(edges))) - delay
    assert len(edges) > 10
    np.testing.assert_allclose(2.0 * turns, np.round(2.0 * turns), atol=1e-4)
    # Just after the start, half of the first period is positive.
    for t in (0.21, 0.9, 1.3, 1.99):
        turn = float(clock.turns(jnp.asarray(t))) - np.interp(t, clock.times, rows[1])
        sign = 1.0 if turn % 1.0 < 0.5 else -1.0
        expected = sign * np.interp(t, clock.times, rows[0]) + np.interp(t, clock.times, rows[2])
        np.testing.assert_allclose(wave.at(jnp.asarray(t)), expected, rtol=1e-12)


def test_the_wave_is_differentiable_with_respect_to_its_frequency():
    def moved(f):
        clock = Clock(jnp.array([0.0, 1.0]), jnp.stack([f, 2.0 * f]))
        wave = ScheduledSquareWave(clock, jnp.ones(2), jnp.zeros(2), jnp.zeros(2))
        return jnp.sum(segments(wave, 300).t_break)

    slope = jax.grad(moved)(3.01)
    np.testing.assert_allclose(slope, (moved(3.01 + 1e-7) - moved(3.01 - 1e-7)) / 2e-7, rtol=1e-5)
