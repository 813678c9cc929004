"""Tests of a pinned link: fixed pin, zero moment, equilibrium shapes and changes of side."""

import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics
from slider_jax.beam.state import node_positions, straight_state
from slider_jax.effects import Gravity, NormalDrag
from slider_jax.supports import PinnedLink
from tests.support.helpers import dense_newton, march, nodes_of, stage_of, swimmer, uniform

L, MASS, G = 0.368, 0.7, 9.81
FINE = Numerics(tail_cells=10, body_cells=40)
FREQUENCY, PER_STRIDE, STRIDES = 2.0, 160, 3


def pin(x):
    """Returns the pin's position, velocity and moment [N m], the head, the tip and its speed."""
    T, _, M, V_tau, V_n, phi = x.y[:, -1]
    omega = (phi - x.stage.phi_head) / x.stage.reference.dt
    arm = x.stage.support.arm(x.t)
    anchor = x.head + x.stage.support.anchor_offset(phi, x.t)
    shape = node_positions(x.y[5], x.memory.strain, x.head, x.mesh.grid)
    slip = jnp.stack([V_tau - arm * omega, V_n])
    speed = jnp.stack(
        [V_tau * jnp.cos(phi) - V_n * jnp.sin(phi), V_tau * jnp.sin(phi) + V_n * jnp.cos(phi)]
    )
    return anchor, slip, M + arm * T, x.head, shape[:, 0], speed


def climber(sign=1.0, frequency=0.0):
    """Returns a driven robot in air with its weight; `sign` = -1 mirrors drive and link."""
    support = PinnedLink(0.03, frequency, 0.0 if sign > 0 else 0.5)
    effects = (NormalDrag(3.0, 1.2), Gravity(G))
    return swimmer(FREQUENCY, sign * 200e3, effects=effects, support=support)


def climb(model, per_stride=PER_STRIDE):
    return march(model, 1.0 / (FREQUENCY * per_stride), PER_STRIDE * STRIDES, pin)


@pytest.mark.slow
def test_the_pin_neither_moves_nor_carries_moment():
    t, (anchor, slip, moment, head, tip, speed) = climb(climber())
    print(
        f"pin moved {np.abs(anchor).max():.1e} m, slip {np.abs(slip).max():.1e} m/s, "
        f"moment {np.abs(moment).max():.1e} N m, tip swung {np.ptp(tip[:, 1]):.3f} m"
    )
    assert np.ptp(tip[:, 1]) > 0.02
    assert np.abs(anchor - [0.0, 0.015]).max() < 1e-14
    assert np.abs(slip).max() < 1e-12
    assert np.abs(moment).max() < 1e-12
    np.testing.assert_allclose(np.linalg.norm(head - [0.0, 0.015], axis=1), 0.015, rtol=1e-12)
    h = t[1] - t[0]
    walked = np.cumsum(0.5 * h * (speed[1:] + speed[:-1]), axis=0)
    swing = np.ptp(head[:, 0])
    assert np.abs(walked - (head[1:] - head[0])).max() < 0.02 * swing


def hanging(EI, link):
    """Returns the nodal angles (N,) of a rod at rest on a link under its weight."""
    model = uniform(L, EI, (Gravity(G),), PinnedLink(link))
    y, _ = straight_state(nodes_of(model, FINE))
    y, error = dense_newton(stage_of(model, FINE, y, 1e9), y)
    assert error < 1e-8
    return np.asarray(y[5])


@pytest.mark.parametrize("link", [0.03, 0.1, -0.1])
def test_a_stiff_body_hangs_with_its_centre_of_mass_below_the_pin(link):
    """Centre of mass at -(L/2) tau from the head, pin at (l_p/2) n: tan(phi) = -l_p/L."""
    phi = hanging(1e4, link)
    print(f"phi {phi[-1]:.6f}, pendulum {-np.arctan(link / L):.6f}")
    np.testing.assert_allclose(phi, -np.arctan(link / L), rtol=1e-3)


def hanging_elastica(EI, link):
    """Returns phi at tail and head by shooting.

    EI phi' = M, M' = m g s sin(phi), M(0) = 0 at the tail, M(L) + (l_p/2) m g L cos(phi(L)) = 0.
    The weight below each section is (m g s, 0).
    """
    n = 800
    h = L / n
    weight = MASS * G

    def slope(s, z):
        return np.array([z[1] / EI, weight * s * np.sin(z[0])])

    def end(tail):
        z = np.array([tail, 0.0])
        for i in range(n):
            s = i * h
            a = slope(s, z)
            b = slope(s + 0.5 * h, z + 0.5 * h * a)
            c = slope(s + 0.5 * h, z + 0.5 * h * b)
            z = z + h / 6.0 * (a + 2 * b + 2 * c + slope(s + h, z + h * c))
        return z, z[1] + 0.5 * link * weight * L * np.cos(z[0])

    low, high = 0.0, -0.05
    f_low, f_high = end(low)[1], end(high)[1]
    for _ in range(30):
        low, high = high, high - f_high * (high - low) / (f_high - f_low)
        f_low, f_high = f_high, end(high)[1]
        if abs(f_high) < 1e-13:
            break
    return high, end(high)[0][0]


def test_a_soft_body_hangs_like_the_heavy_elastica():
    phi = hanging(0.038, 0.1)
    tail, head = hanging_elastica(0.038, 0.1)
    print(f"head {phi[-1]:.6f} / {head:.6f} rad, tail {phi[0]:.6f} / {tail:.6f} rad")
    assert abs(head) > 0.2 and abs(tail) < 0.5 * abs(head)
    assert phi[-1] == pytest.approx(head, rel=1e-3)
    assert phi[0] == pytest.approx(tail, rel=1e-3)


@pytest.mark.slow
def test_the_pin_changes_sides_with_the_stride():
    """The pin is fixed during a half stride, and each switch moves it by the link's length."""
    _, (anchor, slip, moment, *_) = climb(climber(frequency=FREQUENCY))
    halves = anchor.reshape(2 * STRIDES, PER_STRIDE // 2, 2)
    assert np.abs(halves - halves[:, :1]).max() < 1e-8
    jumps = np.linalg.norm(np.diff(halves[:, -1], axis=0), axis=1)
    np.testing.assert_allclose(jumps, 0.03, rtol=1e-9)
    assert np.abs(slip).max() < 1e-8 and np.abs(moment).max() < 1e-8


@pytest.mark.parametrize("per_stride", [PER_STRIDE, 151])
def test_the_head_does_not_jump_when_the_pin_changes_sides(per_stride):
    """With an odd number of steps a switch within a step takes effect at the nearer end."""
    t, (anchor, _, _, head, _, speed) = climb(climber(frequency=FREQUENCY), per_stride)
    switches = np.flatnonzero(np.linalg.norm(np.diff(anchor, axis=0), axis=1) > 0.01)
    h = t[1] - t[0]
    wanted = 0.5 / FREQUENCY * np.arange(1, len(switches) + 1)
    assert len(switches) == int(t[-1] * 2 * FREQUENCY - 1e-6)
    assert np.abs(t[switches] - wanted).max() < 0.5 * h * (1 + 1e-9)
    moved = np.linalg.norm(np.diff(head, axis=0), axis=1)
    fastest = np.maximum(np.linalg.norm(speed[1:], axis=1), np.linalg.norm(speed[:-1], axis=1))
    assert moved.max() < 2.0 * h * fastest.max() < 0.005
    # Each pin is fixed until the next switch.
    for interval in np.split(anchor, switches + 1):
        assert np.ptp(interval, axis=0).max() < 1e-14


def test_a_mirrored_drive_climbs_the_mirrored_path():
    _, right = climb(climber(frequency=FREQUENCY))
    _, left = climb(climber(-1.0, frequency=FREQUENCY))
    for a, b in zip(right[:1] + right[3:5], left[:1] + left[3:5], strict=True):
        np.testing.assert_allclose(a, b * np.array([1.0, -1.0]), atol=1e-9)
    assert np.ptp(right[4][:, 1]) > 0.02
