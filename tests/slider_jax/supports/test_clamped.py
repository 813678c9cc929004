"""Tests of a clamp on a carriage that tows, heaves and pitches: the head follows the carriage."""

import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.dynamics.step import at_rest
from slider_jax.supports import Clamped
from tests.support.helpers import SMALL, march, nodes_of, order, swimmer

TOW, HEAVE, PITCH, F, PHASE = 0.2, 0.02, 0.3, 1.5, 0.7
CLAMP = Clamped(TOW, HEAVE, PITCH, F, PHASE)
SPAN = 0.8


def head(x):
    return jnp.concatenate([x.head, x.y[5, -1:]])


def carriage(t):
    """Returns the carriage's displacement (x, y) [m] and angle [rad] in closed form."""
    angle = PITCH * np.sin(2 * np.pi * F * t + PHASE)
    return np.stack([TOW * t, HEAVE * np.sin(2 * np.pi * F * t), angle], axis=1)


def off(steps):
    t, path = march(swimmer(support=CLAMP), SPAN / steps, steps, head)
    return np.abs(path - carriage(t)).max(axis=0)


@pytest.mark.slow
def test_the_head_follows_the_carriage_to_second_order():
    steps = [160, 320, 640]
    x, y, angle = np.array([off(n) for n in steps]).T
    print(f"x off {x}, y off {y} m, angle off {angle} rad")
    assert x.max() < 1e-12
    assert order(steps, y) == pytest.approx(-2.0, abs=0.1)
    assert order(steps, angle) == pytest.approx(-2.0, abs=0.1)
    assert y[-1] < 1e-3 * HEAVE and angle[-1] < 1e-3 * PITCH


def test_a_body_starts_at_rest_relative_to_the_carriage():
    model, t0 = swimmer(support=CLAMP), 0.123
    _, _, _, V_tau, V_n, phi = at_rest(model, SMALL, t0).history[-1]
    (x, y), angle, rate = CLAMP.start(jnp.asarray(t0))
    ahead = np.array([np.cos(angle), np.sin(angle)])
    left = np.array([-ahead[1], ahead[0]])
    back = float(model.robot.length) - np.asarray(nodes_of(model, SMALL))
    np.testing.assert_allclose(phi, angle)
    np.testing.assert_allclose(V_tau, ahead @ [x, y], rtol=1e-12)
    np.testing.assert_allclose(V_n, left @ [x, y] - rate * back, rtol=1e-12)
